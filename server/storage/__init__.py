"""What is kept: SQL tables with their repositories, and the object store for videos and maps."""
