"""What the follower saw: a few pictures of the walk with the hint that came for each."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.hints import refusal_sentence, sentence
from client_sim.outcome import FrameRecord
from client_sim.walk import Walk
from server.protocol.messages import UpdateMessage

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

GO = "#2ee59d"
REFUSED = "#ff6b6b"
_ARROW = np.array([[-0.32, 0], [-0.32, 1.0], [-0.75, 1.0], [0, 1.9], [0.75, 1.0], [0.32, 1.0], [0.32, 0]])
"""Pointing ahead, its foot at the origin."""

_FLAT = 0.55
"""Height of the arrow as it lies on the floor before the walker, as part of its length."""


def telling_pictures(records: Sequence[FrameRecord], most: int = 5) -> list[FrameRecord]:
    """At most so many answered pictures that tell the walk's story, in its order.

    The beginning, the end, the middle of the longest stretch of refusals, a turn to each side, what came
    after the refusals, and whatever lies between.
    """
    answered = [r for r in records if r.update is not None]
    guided = [r for r in answered if r.update is not None and r.update.guidance is not None]
    fixed = [r for r in guided if r.update is not None and r.update.fix is not None]
    if not fixed:
        return answered[:: max(1, len(answered) // most)][:most]
    chosen = [fixed[min(5, len(fixed) - 1)], fixed[-1]]
    blind = longest_refusal(answered)
    if blind:
        chosen.append(blind[len(blind) // 2])
    for side in ("left", "right"):
        turning = [r for r in fixed if r.update.guidance.instruction == side]  # type: ignore[union-attr]
        if turning:
            chosen.append(turning[len(turning) // 2])
    if blind:
        chosen += [r for r in fixed if r.video_time > blind[-1].video_time + 0.3][:1]
    chosen += fixed[len(fixed) // 4 :: max(1, len(fixed) // 4)]
    unique = list(dict.fromkeys(r.sequence for r in chosen))[:most]
    return [r for r in answered if r.sequence in unique]


def longest_refusal(records: Sequence[FrameRecord], least: int = 3) -> list[FrameRecord]:
    """The longest run of answered pictures without a fix, after the first fix; none below ``least``."""
    best: list[FrameRecord] = []
    run: list[FrameRecord] = []
    found = False
    for record in records:
        if record.update is None:
            continue
        if record.update.fix is not None:
            found, run = True, []
        elif found:
            run.append(record)
            best = max(best, list(run), key=len)
    return best if len(best) >= least else []


def pictures_of(walk: Walk, records: Sequence[FrameRecord]) -> list[NDArray[np.uint8]]:
    """The walk's pictures (H, W, 3), RGB, of some records.

    Raises:
        WalkError: the video cannot be read.
    """
    wanted = {record.frame_index for record in records}
    found = {frame.index: frame.image for frame in walk.frames() if frame.index in wanted}
    return [
        np.asarray(cv2.cvtColor(found[r.frame_index], cv2.COLOR_BGR2RGB), dtype=np.uint8) for r in records
    ]


def draw_picture(axes: Axes, image: NDArray[np.uint8], record: FrameRecord) -> None:
    """A picture with its hint: an arrow on the floor, or a cross, and the sentence below."""
    height, width = image.shape[:2]
    axes.imshow(image)
    axes.set_axis_off()
    update = record.update
    if update is None:
        return
    middle = np.array([width / 2, 0.86 * height])
    size = 0.2 * min(width, height)
    if update.guidance is not None and update.state != "arrived":
        axes.fill(*_arrow(update.guidance.bearing, middle, size).T, color=GO, alpha=0.85, linewidth=0)
        axes.plot(*_arrow(update.guidance.bearing, middle, size).T, color="white", linewidth=1.2)
    elif update.state == "arrived":
        x, y = middle
        axes.scatter(x, y, s=520, color=GO, alpha=0.9, edgecolor="white", linewidth=1.5)
        axes.text(x, y, "✓", color="white", ha="center", va="center", fontsize=17, fontweight="bold")
    elif update.fix is None:
        axes.scatter(width / 2, height / 2, s=900, marker="x", color=REFUSED, linewidth=5, alpha=0.9)
    axes.text(
        0.5,
        -0.03,
        "\n".join(textwrap.wrap(caption(update), 30)),
        transform=axes.transAxes,
        ha="center",
        va="top",
        fontsize=10,
        color="#22303c",
        linespacing=1.25,
    )
    axes.text(
        0.02,
        0.97,
        f"{record.video_time:.1f} s",
        transform=axes.transAxes,
        ha="left",
        va="top",
        fontsize=9,
        color="white",
        bbox={"boxstyle": "round,pad=0.25", "facecolor": "black", "edgecolor": "none", "alpha": 0.45},
    )


def caption(update: UpdateMessage) -> str:
    """What the follower is told, and of a refused picture why."""
    if update.refusal is None or update.guidance is not None:
        return sentence(update)
    return refusal_sentence(update.refusal.reason)


def _arrow(bearing: float, foot: Array, size: float) -> Array:
    """Corners (N, 2) in pixels of an arrow on the floor that points along a bearing, positive to the left."""
    c, s = np.cos(bearing), np.sin(bearing)
    points = np.vstack([_ARROW, _ARROW[:1]])
    # About its middle, so that it stays in the picture whichever way it points.
    turned = (points - [0.0, 0.95]) @ np.array([[c, s], [-s, c]])
    return np.asarray(foot + size * turned * [1.0, -_FLAT] - [0.0, size * _FLAT * 0.4])
