"""The leader's path: upright, in a sensible unit, with its length and its turns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from server.geometry.poses import SE3, Sim3
from server.mapping.route_map import Turn

Array = NDArray[np.float64]


def upright(rotations: Array) -> Array:
    """Up (3,), unit, of a world in which a phone was carried with the given orientations.

    A phone held upright keeps its x axis level, however it is tilted forwards or back; one that is rolled
    onto its side keeps its y axis level instead. Each frame votes with the axis that is level by what is
    believed to be up, from several beliefs in turn (alternating minimisation); where the walk has no turns
    that tell, the mean up of the images decides, and that the picture was upright at first: what turns a
    video's picture upright is written when it begins.

    Args:
        rotations: (F, 3, 3) world_from_camera.
    """
    right, up = rotations[:, :, 0], -rotations[:, :, 1]
    unrolled = _up_of(right, up)
    if ((right @ unrolled) ** 2).mean() < _LEVEL and np.quantile(up @ unrolled, 0.05) > _UPWARD:
        return unrolled
    # (F, 4, 3): up and right of a phone that is upright, and of one that is rolled by quarters.
    ups = np.stack([up, right, -up, -right], axis=1)
    rights = np.stack([right, -up, -right, up], axis=1)
    frames = np.arange(len(rotations))
    starts = np.concatenate([ups[k] for k in np.linspace(0, len(rotations) - 1, 9).astype(int)])
    best, least = unrolled, np.inf
    for belief in (unrolled, *starts):
        rolled = _quarters(ups, belief)
        for _ in range(_MOST_VOTES):
            belief = _up_of(rights[frames, rolled], ups[frames, rolled])
            before, rolled = rolled, _quarters(ups, belief)
            if np.array_equal(before, rolled):
                break
        cost = _disbelief(rights[frames, rolled], ups[frames, rolled], belief, rolled != 0)
        if cost < least:
            best, least = belief, cost
    return best


_LEVEL = float(np.sin(np.deg2rad(10.0)) ** 2)
"""A phone that nobody rolls tilts sideways by less, squared and on average."""
_UPWARD = float(np.cos(np.deg2rad(70.0)))
"""And forwards or back by less, nearly always."""
_TILT = 0.05
"""What a tilt forwards or back costs beside a tilt sideways: phones are held so all the time."""
_ROLLED = 0.03
"""What a rolled frame costs beside it."""
_MOST_TILT = 0.1
"""And a frame at most that is tilted sideways: between upright and rolled there always are some."""
_MOST_VOTES = 10


def _up_of(right: Array, up: Array) -> Array:
    """Up (3,) to which the frames' right (F, 3) is level and their up (F, 3) is near."""
    mean_up = up.mean(axis=0)
    mean_up /= max(float(np.linalg.norm(mean_up)), 1e-9)
    level = np.einsum("fi,fj->ij", right, right) / len(right)
    tilt = _TILT * (np.eye(3) - np.outer(mean_up, mean_up))
    vector = np.linalg.eigh(level + tilt)[1][:, 0]
    return np.asarray(vector * np.sign(vector @ mean_up))


def _quarters(ups: Array, belief: Array) -> NDArray[np.int64]:
    """(F,) by how many quarters each frame is rolled; one that lies between is taken for upright."""
    return np.asarray(np.argmax(ups @ belief + np.array([0.1, 0.0, 0.0, 0.0]), axis=1))


def _disbelief(right: Array, up: Array, belief: Array, rolled: NDArray[np.bool_]) -> float:
    """How ill a belief fits the frames; that the first ones are rolled weighs most."""
    early = 4.0 * np.linspace(1.0, 0.0, len(rolled)) ** 3
    sideways = np.minimum((right @ belief) ** 2, _MOST_TILT)
    forwards = _TILT * (1.0 - np.maximum(up @ belief, 0.0) ** 2)
    return float((sideways + forwards + _ROLLED * early * rolled).mean())


def route_frame(poses: list[SE3], times: Array) -> Sim3:
    """``route_from_map``: z up, x the first heading, origin at the start, unit: the leader's mean second.

    The unit is the length the leader walked in a second on average, so thresholds in it hold for
    every map although no metre is known.

    Args:
        poses: world_from_camera of the frames; times: (F,) seconds.
    """
    rotations = np.stack([p.rotation for p in poses])
    positions = np.stack([p.translation for p in poses])
    up = upright(rotations)
    forward = rotations[0][:, 2] - (rotations[0][:, 2] @ up) * up
    if np.linalg.norm(forward) < 1e-3:
        forward = rotations[0][:, 0] - (rotations[0][:, 0] @ up) * up
    forward /= np.linalg.norm(forward)
    rotation = np.stack([forward, np.cross(up, forward), up])
    length = walked(positions, times)[-1]
    duration = max(float(times[-1] - times[0]), 1e-3)
    scale = duration / length if length > 1e-12 else 1.0
    return Sim3(scale, rotation, -scale * rotation @ positions[0])


def walked(positions: Array, times: Array) -> Array:
    """(F,) length of the path without the bobbing of the steps, units of the positions (F, 3)."""
    smooth = smoothed(positions, times)
    steps = np.linalg.norm(np.diff(smooth, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def smoothed(positions: Array, times: Array, seconds: float = 0.4) -> Array:
    """Positions (F, 3) low-passed over ``seconds`` (one standard deviation); steps are about 2 Hz."""
    if len(positions) < 3:
        return positions
    sigma = seconds / max(float(np.median(np.diff(times))), 1e-3)
    half = int(4.0 * sigma + 0.5)
    # Mirrored through its ends, so that they stay where they are.
    padded = np.pad(positions, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
    return np.asarray(gaussian_filter1d(padded, sigma, axis=0, mode="nearest")[half : half + len(positions)])


def find_turns(
    positions: Array,
    arc_length: Array,
    *,
    step: float = 0.2,
    reach: float = 0.8,
    min_rate: float = float(np.deg2rad(15.0)),
    min_angle: float = float(np.deg2rad(35.0)),
) -> tuple[Turn, ...]:
    """Turns of a path of smoothed positions (F, 3), z up.

    Args:
        arc_length: (F,) not decreasing.
        step: spacing at which the path is looked at; reach: length over which a heading is taken.
        min_rate: heading change per unit of length that belongs to a turn, radians.
        min_angle: whole change from which it is one, radians.
    """
    total = float(arc_length[-1])
    if total < 2 * reach:
        return ()
    at = np.arange(0.0, total, step)
    keep = np.concatenate([[True], np.diff(arc_length) > 1e-9])
    x = np.interp(at, arc_length[keep], positions[keep, 0])
    y = np.interp(at, arc_length[keep], positions[keep, 1])
    width = max(1, round(reach / step / 2))
    ahead = np.minimum(np.arange(len(at)) + width, len(at) - 1)
    behind = np.maximum(np.arange(len(at)) - width, 0)
    heading = np.unwrap(np.arctan2(y[ahead] - y[behind], x[ahead] - x[behind]))
    rate = np.gradient(heading, step)
    turns: list[Turn] = []
    for sign in (1.0, -1.0):
        inside = sign * rate > min_rate
        edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            angle = float(heading[end - 1] - heading[begin])
            if abs(angle) >= min_angle:
                turns.append(Turn(float(at[begin]), float(at[end - 1]), angle))
    return tuple(sorted(turns, key=lambda t: t.start))
