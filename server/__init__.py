"""The pairnavi cloud service; see docs/architecture.md for the folders, top to bottom."""
