"""Rigid motions, cameras, absolute pose and two-view geometry; conventions in docs/conventions.md."""
