"""Use cases: the life of a route, its builds, navigation sessions."""
