"""The navigation socket's endpoint: opens the connection and finds the route and the session."""

from __future__ import annotations

from fastapi import APIRouter, WebSocket

from server.api.auth import Caller, is_same_origin
from server.api.components import Parts
from server.api.navigation_connection import ConnectionOptions, NavigationConnection

router = APIRouter(tags=["navigation"])


@router.websocket("/v1/routes/{route_id}/navigate")
async def navigate(websocket: WebSocket, route_id: str, caller: Caller, parts: Parts) -> None:
    """Pictures in, updates out; see docs/protocol.md."""
    settings = parts.settings
    options = ConnectionOptions(
        max_frame_bytes=settings.max_frame_bytes,
        max_message_bytes=settings.max_message_bytes,
        max_pixels=settings.max_pixels,
        max_frames_per_second=settings.max_frames_per_second,
        max_messages_per_second=settings.max_messages_per_second,
        heartbeat_interval_s=settings.heartbeat_interval_s,
        idle_timeout_s=settings.idle_timeout_s,
        hello_timeout_s=settings.hello_timeout_s,
        send_timeout_s=settings.send_timeout_s,
        resume_within_s=settings.resume_within_s,
    )
    connection = NavigationConnection(
        websocket, parts.navigation, parts.routes, parts.builds, parts.database, options
    )
    await connection.run(caller.owner, route_id, same_origin=is_same_origin(websocket))
