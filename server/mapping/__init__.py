"""The leader's side: from a video to an immutable route map."""
