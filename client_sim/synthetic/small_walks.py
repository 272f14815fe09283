"""A leader and a follower in a very small building: the quickest walks that a map can be built from."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import PinholeCamera
from client_sim.synthetic.gait import Gait
from client_sim.synthetic.rendering import Light, Renderer
from client_sim.synthetic.trajectories import walk
from client_sim.synthetic.walk_folders import write_walk

ROUTE = ((0.8, 1.0), (7.0, 1.0), (7.0, 7.4), (11.2, 8.5))
"""Waypoints, metres: along both corridors, a turn to the left, and to the right into the room."""

LEADER_CAMERA = PinholeCamera()
FOLLOWER_CAMERA = PinholeCamera(fx=540.0, fy=540.0)


def write_small_walks(
    folder: Path, on_progress: Callable[[float], None] | None = None, *, seed: int = 7
) -> tuple[Path, Path]:
    """Write ``leader`` and ``follower`` walk folders below ``folder`` and return their paths.

    The follower walks up to 0.3 m beside the leader, with another camera, in other light.

    Args:
        on_progress: gets the fraction done of both, 0 to 1.

    Raises:
        OSError: a file cannot be written.
    """
    building, leading, following = (np.random.default_rng([seed, stream]) for stream in range(3))
    world = build_world("synthetic", CORRIDOR_AND_ROOM, building)

    def report(start: float) -> Callable[[float], None] | None:
        return None if on_progress is None else lambda fraction: on_progress(start + fraction / 2)

    leader, follower = folder / "leader", folder / "follower"
    gait = Gait()
    write_walk(
        leader,
        Renderer(world, LEADER_CAMERA),
        walk(ROUTE, leading, gait),
        leading,
        light=Light(),
        meta={"role": "leader", "seed": seed, "camera_height_m": gait.height},
        on_progress=report(0.0),
    )
    other = Gait(speed=1.2, height=1.6, step_rate=2.05, pitch=-0.03)
    write_walk(
        follower,
        Renderer(world, FOLLOWER_CAMERA),
        walk(ROUTE, following, other, wander=0.3),
        following,
        light=Light(gain=0.88, gamma=1.1, warmth=1.12),
        meta={"role": "follower", "seed": seed, "camera_height_m": other.height},
        on_progress=report(0.5),
    )
    return leader, follower
