"""A picture of a replay: both tracks from above, progress over time, and what the follower saw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from client_sim.filmstrip import draw_picture, longest_refusal, pictures_of, telling_pictures
from client_sim.outcome import FollowOutcome, FrameRecord
from client_sim.plan import FloorPlan, Similarity, in_plan
from client_sim.walk import Walk
from server.protocol.documents import PathDocument, RouteDocument

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

_INK = "#22303c"
_FAINT = "#9aa7b2"
_GRID = "#e6eaee"
_WALL = "#d5dbe1"
_LEADER = "#b8c4ce"
_FOLLOWER = "#1f6feb"
_REFUSED = "#d1495b"
_START = "#2a9d6f"
_DESTINATION = "#7b4fb5"

_WIDTH_IN, _DPI = 14.0, 120
_MAP_IN = (4.2, 7.0)
"""Least and greatest height of the map."""
_ASIDE_IN = 3.6
_STRIP_IN = 2.9
_MARGIN_M = 1.5


@dataclass(frozen=True, eq=False, slots=True)
class Drawn:
    """Tracks in the plane of the picture.

    Attributes:
        leader: (N, 2).
        follower: (F, 2), one row a record, NaN without a fix.
        turns: where the route turns, (2,), and by how much, radians.
        unit: of the axes.
        walls: (W, 4) of the plan, none without one.
    """

    leader: Array
    follower: Array
    turns: tuple[tuple[Array, float], ...]
    unit: str
    walls: Array

    @property
    def extent(self) -> tuple[Array, Array]:
        """Corners (2,) of what has to be seen."""
        points = np.vstack([self.leader, self.follower[np.isfinite(self.follower[:, 0])]])
        margin = _MARGIN_M if self.unit == "m" else 0.07 * float(np.ptp(points, axis=0).max())
        return points.min(axis=0) - margin, points.max(axis=0) + margin


def draw_tracks(
    route: RouteDocument,
    path: PathDocument,
    outcome: FollowOutcome,
    target: Path,
    *,
    walk: Walk | None = None,
    plan: FloorPlan | None = None,
) -> None:
    """Write a PNG of a follower's replay on a route.

    Args:
        walk: the follower's, for a few of its pictures.
        plan: of the building, for its walls behind the tracks.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    drawn = place_tracks(path, outcome.records, plan)
    low, high = drawn.extent
    across, along = high - low
    map_height = float(np.clip((_WIDTH_IN - _ASIDE_IN) * along / across, *_MAP_IN))
    story = [] if walk is None else telling_pictures(outcome.records)
    height = 0.8 + map_height + (_STRIP_IN if story else 0.0)
    figure = Figure(figsize=(_WIDTH_IN, height), facecolor="white")
    FigureCanvasAgg(figure)
    _title(figure, route, outcome, height)
    bottom = (_STRIP_IN if story else 0.0) / height
    top = 1.0 - 0.8 / height
    # The map takes the width that its shape asks for, the columns beside it the rest.
    width = min(_WIDTH_IN - _ASIDE_IN, map_height * across / along)
    edge = width / _WIDTH_IN
    _draw_map(figure.add_axes((0.01, bottom, edge, top - bottom)), route, drawn, outcome.records)
    left = edge + 0.055
    half = (top - bottom) / 2
    _draw_progress(figure.add_axes((left, bottom + half + 0.06, 0.985 - left, half - 0.1)), outcome)
    _draw_ages(figure.add_axes((left, bottom + 0.06, 0.985 - left, half - 0.1)), outcome)
    if walk is not None:
        for k, (record, image) in enumerate(zip(story, pictures_of(walk, story), strict=True)):
            part = 0.98 / len(story)
            draw_picture(
                figure.add_axes((0.01 + k * part + 0.004, 0.62 / height, part - 0.008, 2.0 / height)),
                image,
                record,
            )
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=_DPI)


def place_tracks(path: PathDocument, records: list[FrameRecord], plan: FloorPlan | None) -> Drawn:
    """Lay both tracks into the plan, or without one into the plane that the path lies in."""
    leader = np.asarray(path.position, dtype=np.float64).reshape(-1, 3)
    fixes = np.full((len(records), 3), np.nan)
    for row, record in zip(fixes, records, strict=True):
        if record.update is not None and record.update.fix is not None:
            row[:] = record.update.fix.position
    if plan is not None:
        lay = in_plan(plan, np.asarray(path.time_s), leader)
        unit, walls = "m", plan.walls
    else:
        scale = path.metres_per_unit or 1.0
        axes = plane_from_above(leader)
        lay = Similarity(scale, np.vstack([axes, np.cross(axes[0], axes[1])]), np.zeros(3))
        unit, walls = ("m" if path.metres_per_unit else "map units, scale unknown"), np.zeros((0, 4))
    laid, arc = lay(leader)[:, :2], np.asarray(path.arc_length)
    turns = []
    for turn in path.turns:
        at = np.interp((turn.start + turn.end) / 2, arc, np.arange(len(arc)))
        turns.append((laid[round(float(at))], turn.angle))
    return Drawn(laid, lay(fixes)[:, :2], tuple(turns), unit, walls)


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


def _title(figure: Figure, route: RouteDocument, outcome: FollowOutcome, height: float) -> None:
    summary = outcome.summary()
    end = "arrived" if summary.arrived else "not arrived"
    figure.text(
        0.015,
        1.0 - 0.3 / height,
        f"{route.start_label} → {route.destination_label}: {end}",
        fontsize=17,
        fontweight="bold",
        color=_INK,
        va="center",
    )
    refused = summary.answered - summary.relocalized
    figure.text(
        0.015,
        1.0 - 0.62 / height,
        f"{summary.relocalized} of {summary.frames} pictures found on the leader's way, {refused} refused",
        fontsize=11,
        color=_FAINT,
        va="center",
    )


def _draw_map(axes: Axes, route: RouteDocument, drawn: Drawn, records: list[FrameRecord]) -> None:
    if len(drawn.walls):
        x, y = drawn.walls[:, [0, 2]], drawn.walls[:, [1, 3]]
        gap = np.full((len(x), 1), np.nan)
        axes.plot(
            np.hstack([x, gap]).ravel(), np.hstack([y, gap]).ravel(), color=_WALL, linewidth=1.4, zorder=0
        )
    line = drawn.leader
    axes.plot(*line.T, color=_LEADER, linewidth=9, solid_capstyle="round", label="leader's way", zorder=1)
    axes.plot(*line.T, color="white", linewidth=1.2, linestyle=(0, (4, 4)), zorder=2)
    axes.plot(*drawn.follower.T, color=_FOLLOWER, linewidth=1.6, alpha=0.7, zorder=4)
    axes.scatter(
        drawn.follower[:, 0],
        drawn.follower[:, 1],
        s=13,
        color=_FOLLOWER,
        linewidth=0,
        label="follower's fixes",
        zorder=4,
    )
    _draw_blind(axes, drawn, records)
    for place, angle in drawn.turns:
        side = "left" if angle > 0 else "right"
        axes.annotate(
            f"{abs(np.degrees(angle)):.0f}° {side}",
            (place[0], place[1]),
            textcoords="offset points",
            xytext=(0, 17),
            ha="center",
            fontsize=9.5,
            color=_INK,
            zorder=7,
            bbox=_label_box(),
        )
        axes.scatter(place[0], place[1], s=46, facecolor="white", edgecolor=_INK, linewidth=1.4, zorder=5)
    for point, label, colour in (
        (line[0], route.start_label, _START),
        (line[-1], route.destination_label, _DESTINATION),
    ):
        axes.scatter(point[0], point[1], s=190, color=colour, edgecolor="white", linewidth=2, zorder=6)
        axes.annotate(
            label,
            point,
            textcoords="offset points",
            xytext=(0, -22),
            ha="center",
            color=colour,
            fontsize=12,
            fontweight="bold",
            zorder=7,
            bbox=_label_box(),
        )
    low, high = drawn.extent
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    _draw_ruler(axes, low, high, drawn.unit)
    # Above the columns beside the map: on it, it would cover something.
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        frameon=False,
        labelcolor=_INK,
        fontsize=10,
        borderaxespad=0.3,
    )


def _draw_blind(axes: Axes, drawn: Drawn, records: list[FrameRecord]) -> None:
    """Where the longest stretch of refusals was: between the last fix before it and the first after."""
    blind = longest_refusal(records)
    if not blind:
        return
    rows = [k for k, record in enumerate(records) if record.sequence in {r.sequence for r in blind}]
    before = [row for row in drawn.follower[: rows[0]] if np.isfinite(row[0])]
    after = [row for row in drawn.follower[rows[-1] + 1 :] if np.isfinite(row[0])]
    if not before:
        return
    ends = np.array([before[-1], (after or before)[0 if after else -1]])
    seconds = blind[-1].video_time - blind[0].video_time + 0.1
    axes.plot(
        *ends.T,
        color=_REFUSED,
        linewidth=4.5,
        solid_capstyle="round",
        zorder=5,
        label=f"refused for {seconds:.1f} s: {len(blind)} pictures",
    )
    middle = ends.mean(axis=0)
    inwards = 1 if middle[0] < np.mean(drawn.extent, axis=0)[0] else -1
    axes.annotate(
        "nothing to see:\nno fix, no guess",
        (middle[0], middle[1]),
        textcoords="offset points",
        xytext=(24 * inwards, -34),
        ha="left" if inwards > 0 else "right",
        fontsize=10,
        color=_REFUSED,
        fontweight="bold",
        zorder=7,
        bbox=_label_box(),
        arrowprops={"arrowstyle": "-", "color": _REFUSED, "linewidth": 1.2},
    )


def _draw_ruler(axes: Axes, low: Array, high: Array, unit: str) -> None:
    length = 5.0 if unit == "m" and high[0] - low[0] > 12 else 1.0
    x, y = low[0] + 0.03 * (high[0] - low[0]), low[1] + 0.035 * (high[1] - low[1])
    axes.plot([x, x + length], [y, y], color=_INK, linewidth=2.5, solid_capstyle="butt", zorder=6)
    text = f"{length:.0f} m" if unit == "m" else f"1 of {unit}"
    axes.annotate(
        text,
        (x + length / 2, y),
        textcoords="offset points",
        xytext=(0, 5),
        ha="center",
        fontsize=9,
        color=_INK,
        zorder=7,
    )


def _label_box() -> dict[str, object]:
    return {"boxstyle": "round,pad=0.22", "facecolor": "white", "edgecolor": "none", "alpha": 0.82}


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
    _style(axes, "Progress, % (red: refused, grey: no answer)", "")


def _draw_ages(axes: Axes, outcome: FollowOutcome) -> None:
    answered = [r for r in outcome.records if r.age_ms is not None]
    times = [r.video_time for r in answered]
    ages = [r.age_ms for r in answered if r.age_ms is not None]
    axes.scatter(times, ages, s=10, color=_FOLLOWER, alpha=0.7, linewidth=0)
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
                bbox=_label_box(),
            )
    axes.set_ylim(bottom=0)
    _style(axes, "Age of the answers when they arrive, ms", "seconds of the walk")


def _style(axes: Axes, title: str, x: str) -> None:
    axes.set_title(title, loc="left", fontsize=10.5, color=_INK)
    axes.set_xlabel(x, color=_FAINT)
    axes.grid(color=_GRID, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=_FAINT, length=0)
    for side in axes.spines.values():
        side.set_visible(False)
