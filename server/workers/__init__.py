"""Processes that do the heavy work: builds, and the navigation pool."""
