"""The reference phone: replays recorded and synthetic walks over the real protocol."""
