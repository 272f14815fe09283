"""Local features: extraction, matching, place retrieval."""
