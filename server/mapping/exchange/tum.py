"""The leader's trajectory as a TUM file.

One line a pose, ``t tx ty tz qx qy qz qw``, world_from_camera; lines that begin with ``#`` are comments
(Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", 2012, and the tools beside it).
"""

from __future__ import annotations

import numpy as np

from server.mapping.exchange.units import export_scale, unit_in_words
from server.mapping.route_map import RouteMap


def tum_trajectory(route_map: RouteMap, *, keyframes_only: bool = False) -> str:
    """The text of a TUM file: times on the video's clock, seconds; positions as the header says.

    Frames that were not tracked are left out: a pose between two others is no measurement.
    """
    path, keyframes = route_map.path, route_map.keyframes
    if keyframes_only:
        time, position, quaternion = path.time[keyframes.frame], keyframes.position, keyframes.quaternion
        what = "keyframes"
    else:
        tracked = np.asarray(path.tracked)
        time, position, quaternion = path.time[tracked], path.position[tracked], path.quaternion[tracked]
        what = f"tracked frames, of {len(path)}"
    lines = [
        "# trajectory of the leader's camera: t tx ty tz qx qy qz qw, world_from_camera",
        f"# {len(time)} {what}; camera axes x right, y down, z forward; world z up",
        f"# t in seconds on the video's clock; lengths in {unit_in_words(route_map)}",
    ]
    position = export_scale(route_map) * position
    for t, p, q in zip(time.tolist(), position.tolist(), quaternion.tolist(), strict=True):
        lines.append(" ".join([f"{t:.6f}", *(f"{v:.6f}" for v in p), *(f"{v:.9f}" for v in q)]))
    return "\n".join(lines) + "\n"
