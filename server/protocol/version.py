"""Version of the wire contract."""

from __future__ import annotations

PROTOCOL_VERSION = 1
"""Of the navigation socket's messages and frames; the HTTP paths carry it as ``/v1``."""
