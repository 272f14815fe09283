"""HTTP and WebSocket: parses, asks a service, presents. No logic of its own."""
