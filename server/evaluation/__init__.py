"""Judging a route and its followers against the truth of recorded walks; nothing else sees that truth."""
