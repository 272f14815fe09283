"""A seeded synthetic building, walked through with exact truth: walk folders without any recording."""
