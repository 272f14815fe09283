"""What a phone's motion sensors and radios tell about a walk: steps, heading, height, anchors."""
