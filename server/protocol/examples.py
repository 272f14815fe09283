"""One example of each message and of the documents that are often written by hand."""

from __future__ import annotations

from typing import Any

CAMERA_EXAMPLE: dict[str, Any] = {
    "model": "PINHOLE",
    "width": 640,
    "height": 480,
    "params": [540.0, 540.0, 320.0, 240.0],
    "fps": None,
}

_FRAMES = {"received": 42, "answered": 40, "replaced": 1, "stale": 0, "bad": 0}

MESSAGE_EXAMPLES: dict[str, dict[str, Any]] = {
    "hello": {
        "type": "hello",
        "protocol": 1,
        "camera": CAMERA_EXAMPLE,
        "orientation": 0,
        "clock_us": 1_200_000,
        "capabilities": ["jpeg"],
        "resume_token": None,
    },
    "ping": {"type": "ping", "id": 3, "clock_us": 6_200_000, "round_trip_us": 31_000},
    "end": {"type": "end"},
    "welcome": {
        "type": "welcome",
        "protocol": 1,
        "session_id": "5b0cf1d98a4b4c0e9d0c6f6d8f1f2a77",
        "resume_token": "n3ZqW0v5o1mX2k9cJtq8uGf7yR4sLhBdTzEaVxNpKwI",
        "resumed": False,
        "last_sequence": None,
        "server_clock_us": 88_200_000,
        "heartbeat_interval_s": 5.0,
        "idle_timeout_s": 20.0,
        "resume_within_s": 120.0,
        "limits": {
            "max_frame_bytes": 2_097_152,
            "max_message_bytes": 65_536,
            "max_pixels": 16_000_000,
            "max_frames_per_second": 30.0,
        },
        "route": {
            "id": "0d3f5c5e-6b0a-4f0e-9b57-3f0a2f0e7c11",
            "name": "To the lab",
            "start_label": "Door",
            "destination_label": "Lab",
            "length_m": None,
            "duration_s": 46.3,
            "turns": 4,
        },
    },
    "update": {
        "type": "update",
        "sequence": 41,
        "capture_time_us": 5_300_000,
        "age": {"server_ms": 34.1, "capture_ms": 52.8},
        "state": "on_route",
        "fix": {
            "position": [4.1, -0.2, 0.03],
            "orientation": [0.5, -0.5, 0.5, -0.5],
            "position_sigma": 0.01,
            "rotation_sigma": 0.002,
            "inliers": 143,
            "matches": 201,
            "keyframe": 38,
        },
        "refusal": None,
        "guidance": {
            "progress": 0.31,
            "walked_m": None,
            "remaining_m": None,
            "remaining_s": 31.8,
            "instruction": "straight",
            "bearing": 0.05,
            "next_turn": {"angle": 1.52, "distance_m": None, "seconds": 4.2},
        },
        "frames": _FRAMES,
    },
    "error": {
        "type": "error",
        "code": "stale_frame",
        "detail": "frame 40 came after 41, or its time went back",
        "sequence": 40,
        "fatal": False,
    },
    "pong": {"type": "pong", "id": 3, "clock_us": 6_200_000, "server_clock_us": 94_100_000},
    "goodbye": {"type": "goodbye", "reason": "going_away", "may_resume": True, "frames": _FRAMES},
}

DOCUMENT_EXAMPLES: dict[str, dict[str, Any]] = {
    "CameraDescription": CAMERA_EXAMPLE,
    "CreateRoute": {
        "name": "To the lab",
        "start_label": "Door",
        "destination_label": "Lab",
        "measured_length_m": 41.5,
    },
    "Problem": {
        "type": "urn:pairnavi:problem:route_not_ready",
        "title": "Route not ready",
        "status": 409,
        "detail": "the route is building",
        "code": "route_not_ready",
        "instance": "/v1/routes/0d3f5c5e-6b0a-4f0e-9b57-3f0a2f0e7c11/map",
    },
}
