"""Route maps in the formats of others: COLMAP models, TUM trajectories, PLY; and maps from COLMAP models."""
