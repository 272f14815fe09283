"""A picture of a replay: both tracks from above, progress and age over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from client_sim.outcome import FollowOutcome, FrameRecord
from server.protocol.documents import PathDocument, RouteDocument

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]

_INK = "#22303c"
_FAINT = "#9aa7b2"
_GRID = "#e6eaee"
_LEADER = "#b8c4ce"
_FOLLOWER = "#1f6feb"
_REFUSED = "#d1495b"
_START = "#2a9d6f"
_DESTINATION = "#7b4fb5"


def draw_tracks(route: RouteDocument, path: PathDocument, outcome: FollowOutcome, target: Path) -> None:
    """Write a PNG of a follower's replay on a route."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 8), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.55, 1.0))
    _draw_map(figure.add_subplot(grid[:, 0]), route, path, outcome)
    _draw_progress(figure.add_subplot(grid[0, 1]), outcome)
    _draw_ages(figure.add_subplot(grid[1, 1]), outcome)
    summary = outcome.summary()
    figure.suptitle(
        f"{route.name}: {summary.relocalized} of {summary.frames} pictures relocalized"
        f"{', arrived' if summary.arrived else ''}",
        x=0.01,
        ha="left",
        fontsize=15,
        fontweight="bold",
        color=_INK,
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=120)


def plane_from_above(positions: Array) -> Array:
    """Axes (2, 3) of the plane a path lies in, seen from above: the first along its longest extent.

    Args:
        positions: (N, 3), world z up as far as it is known, which need not be far: the plane is the
            path's own, its side is z's.
    """
    centred = positions - positions.mean(axis=0)
    _, _, axes = np.linalg.svd(np.vstack([centred, np.zeros((3, 3))]), full_matrices=False)
    along, normal = axes[0], axes[2]
    if normal[2] < 0:
        normal = -normal
    if along[np.argmax(np.abs(along))] < 0:
        along = -along
    return np.stack([along, np.cross(normal, along)])


def _draw_map(axes: Axes, route: RouteDocument, path: PathDocument, outcome: FollowOutcome) -> None:
    scale = path.metres_per_unit or 1.0
    leader = np.asarray(path.position, dtype=np.float64).reshape(-1, 3) * scale
    plane = plane_from_above(leader)
    line = leader @ plane.T
    axes.plot(*line.T, color=_LEADER, linewidth=9, solid_capstyle="round", label="leader", zorder=1)
    axes.plot(*line.T, color="white", linewidth=1.2, linestyle=(0, (4, 4)), zorder=2)
    _draw_follower(axes, outcome.records, plane, scale)
    for point, label, colour in (
        (line[0], route.start_label, _START),
        (line[-1], route.destination_label, _DESTINATION),
    ):
        axes.scatter(point[0], point[1], s=190, color=colour, edgecolor="white", linewidth=2, zorder=6)
        axes.annotate(
            label,
            point,
            textcoords="offset points",
            xytext=(12, 10),
            color=colour,
            fontsize=11,
            fontweight="bold",
            zorder=7,
            bbox={"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.12)
    unit = "m" if path.metres_per_unit is not None else "map units, scale unknown"
    _style(axes, "Both tracks from above", unit, unit)
    axes.legend(loc="best", frameon=False, labelcolor=_INK)


def _draw_follower(axes: Axes, records: list[FrameRecord], plane: Array, scale: float) -> None:
    rows = np.full((len(records), 2), np.nan)
    refused: list[Array] = []
    last: Array | None = None
    for row, record in zip(rows, records, strict=True):
        update = record.update
        if update is not None and update.fix is not None:
            last = plane @ (np.asarray(update.fix.position) * scale)
            row[:] = last
        elif update is not None and last is not None:
            refused.append(last)
    axes.plot(*rows.T, color=_FOLLOWER, linewidth=2.2, label="follower", zorder=4)
    axes.scatter(rows[:, 0], rows[:, 1], s=9, color=_FOLLOWER, zorder=4)
    if refused:
        crosses = np.stack(refused)
        axes.scatter(
            crosses[:, 0],
            crosses[:, 1],
            s=60,
            marker="x",
            color=_REFUSED,
            linewidth=1.8,
            label=f"refused ({len(refused)}), at the last fix",
            zorder=5,
        )


def _draw_progress(axes: Axes, outcome: FollowOutcome) -> None:
    times, progress = [], []
    for record in outcome.records:
        guidance = None if record.update is None else record.update.guidance
        times.append(record.video_time)
        progress.append(np.nan if guidance is None else 100 * guidance.progress)
    axes.plot(times, progress, color=_FOLLOWER, linewidth=2)
    for record in outcome.records:
        if record.update is None:
            axes.axvspan(record.video_time, record.video_time + 0.1, color=_FAINT, alpha=0.25, linewidth=0)
        elif record.update.fix is None:
            axes.axvspan(record.video_time, record.video_time + 0.1, color=_REFUSED, alpha=0.3, linewidth=0)
    axes.set_ylim(-3, 103)
    _style(axes, "Progress on the route (red: refused, grey: no answer)", "walk, s", "%")


def _draw_ages(axes: Axes, outcome: FollowOutcome) -> None:
    answered = [r for r in outcome.records if r.age_ms is not None]
    times = [r.video_time for r in answered]
    ages = [r.age_ms for r in answered if r.age_ms is not None]
    axes.scatter(times, ages, s=10, color=_FOLLOWER, alpha=0.7)
    summary = outcome.summary()
    for value, name in ((summary.age_p50_ms, "median"), (summary.age_p95_ms, "95 %")):
        if value is not None:
            axes.axhline(value, color=_INK, linewidth=1, linestyle=(0, (2, 3)))
            axes.annotate(
                f"{name} {value:.0f} ms",
                (1, value),
                xycoords=("axes fraction", "data"),
                xytext=(-4, 4),
                textcoords="offset points",
                ha="right",
                fontsize=9,
                color=_INK,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
            )
    axes.set_ylim(bottom=0)
    _style(axes, "Age of updates when they arrive", "walk, s", "ms")


def _style(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, loc="left", fontsize=11, color=_INK)
    axes.set_xlabel(x, color=_FAINT)
    axes.set_ylabel(y, color=_FAINT)
    axes.grid(color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=_FAINT, length=0)
    for side in axes.spines.values():
        side.set_visible(False)
