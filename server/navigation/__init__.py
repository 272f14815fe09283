"""The follower's side: relocalization on a route map, guidance, and the session's state machine."""
