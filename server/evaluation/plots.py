"""Pictures of an evaluation: tracks from above, errors along the path, latency."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from server.evaluation.follower import FALSE_POSITION_M, FALSE_ROTATION_DEG, FollowerJudgement
from server.evaluation.leader import LeaderJudgement
from server.evaluation.walk import Trajectory, arc_length

Array = NDArray[np.float64]

TRUTH = "#9aa3ad"
ROUTE = "#1f5fbf"
FIX = "#118a53"
FALSE = "#d62728"
REFUSED = "#e8930c"
OFF_ROUTE = "#7b4fb3"

STYLE: dict[Any, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e6e9ec",
    "grid.linewidth": 0.8,
    "axes.axisbelow": True,
    "axes.edgecolor": "#5b6570",
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.titlesize": 11,
    "font.size": 10,
    "legend.frameon": False,
}


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def ground_plane(trajectory: Trajectory) -> Array:
    """Two axes (2, 3) to look at a walk from above.

    The cameras' mean downward axis stands in for gravity where the truth's world is not z up.
    """
    up = -trajectory.rotation[:, :, 1].mean(axis=0)
    up /= np.linalg.norm(up)
    if up[2] > np.cos(np.radians(15.0)):
        return np.eye(3)[:2]
    flat = (trajectory.position - trajectory.position.mean(axis=0)) @ (np.eye(3) - np.outer(up, up))
    along = np.linalg.svd(flat, full_matrices=False)[2][0]
    return np.stack([along, np.cross(up, along)])


def _draw_route(axes: Axes, leader: LeaderJudgement, plane: Array) -> None:
    truth = leader.truth.position @ plane.T
    route = (leader.alignment.whole @ leader.estimate.position) @ plane.T
    axes.plot(*truth.T, color=TRUTH, linewidth=5, solid_capstyle="round", label="leader, truth")
    axes.plot(*route.T, color=ROUTE, linewidth=1.4, label="leader, map")
    lost = ~leader.tracked
    if lost.any():
        axes.plot(*route[lost].T, ".", color=REFUSED, markersize=5, label="leader, not tracked")
    axes.plot(*truth[0], "o", color="white", markeredgecolor=ROUTE, markersize=9, markeredgewidth=2)
    axes.plot(*truth[-1], "s", color=ROUTE, markersize=9)
    axes.annotate("start", truth[0], xytext=(9, 8), textcoords="offset points", color=ROUTE)
    axes.annotate("destination", truth[-1], xytext=(9, -14), textcoords="offset points", color=ROUTE)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("m")
    axes.set_ylabel("m")


def leader_picture(leader: LeaderJudgement) -> Figure:
    """The leader's map over the truth, and its error along the path."""
    figure = _figure(11, 5.2)
    above, along = figure.subplots(1, 2, width_ratios=(1.25, 1))
    _draw_route(above, leader, ground_plane(leader.truth))
    above.set_title(f"{leader.report.name}: map over truth, from above")
    above.legend(loc="best", fontsize=9)
    walked = arc_length(leader.truth.position)
    along.fill_between(walked, leader.errors, color=ROUTE, alpha=0.15, linewidth=0)
    along.plot(walked, leader.errors, color=ROUTE, linewidth=1.6)
    if (~leader.tracked).any():
        along.plot(walked[~leader.tracked], leader.errors[~leader.tracked], ".", color=REFUSED)
    rmse = leader.report.ate_rmse_m
    if rmse is not None:
        along.axhline(rmse, color="#333333", linestyle=":", linewidth=1.2)
        along.annotate(
            f"RMSE {rmse:.3f} m", (walked[-1], rmse), ha="right", xytext=(0, 4), textcoords="offset points"
        )
    along.set_ylim(bottom=0)
    along.set_title("error along the path")
    along.set_xlabel("walked, m")
    along.set_ylabel("position error after one alignment, m")
    return figure


def _draw_fixes(axes: Axes, judged: FollowerJudgement, plane: Array) -> None:
    truth = judged.truth.position @ plane.T
    fixes = judged.position @ plane.T
    axes.plot(*truth.T, color="#4c5661", linewidth=1.0, label="follower, truth")
    away = ~judged.on_route
    if away.any():
        axes.plot(
            *np.where(away[:, None], truth, np.nan).T,
            color=OFF_ROUTE,
            linewidth=2.2,
            label="follower off the route, truth",
        )
    right = judged.fixed & ~judged.false
    axes.plot(*fixes[right].T, ".", color=FIX, markersize=4.5, label=f"{right.sum()} fixes")
    refused = ~judged.fixed & judged.on_route
    if refused.any():
        axes.plot(
            *truth[refused].T, "x", color=REFUSED, markersize=6, label=f"{refused.sum()} refused on the route"
        )
    for row in np.flatnonzero(judged.false):
        axes.plot(*np.stack([truth[row], fixes[row]]).T, color=FALSE, linewidth=0.8, alpha=0.7)
    if judged.false.any():
        axes.plot(
            *fixes[judged.false].T, "X", color=FALSE, markersize=8, label=f"{judged.false.sum()} false fixes"
        )


def _draw_wrong_building(axes: Axes, judged: FollowerJudgement, plane: Array) -> None:
    fixes = judged.position[judged.false] @ plane.T
    axes.plot(*fixes.T, "X", color=FALSE, markersize=8, label=f"{len(fixes)} fixes in a wrong building")


def _draw_error(axes: Axes, place: Array, error: Array, judged: FollowerJudgement, limit: float) -> None:
    floor = limit / 1000.0
    good = np.isfinite(error) & ~judged.false
    axes.plot(place[good], np.maximum(error[good], floor), ".", color=FIX, markersize=4)
    bad = np.isfinite(error) & judged.false
    axes.plot(place[bad], np.maximum(error[bad], floor), "X", color=FALSE, markersize=7)
    refused = ~judged.fixed
    axes.plot(place[refused], np.full(refused.sum(), floor * 0.6), "|", color=REFUSED, markersize=9)
    axes.axhline(limit, color=FALSE, linestyle="--", linewidth=1)
    for start, end in _intervals(~judged.on_route):
        axes.axvspan(place[start], place[end - 1], color=OFF_ROUTE, alpha=0.1, linewidth=0)
    axes.set_yscale("log")
    axes.set_ylim(floor * 0.4, max(limit * 3, np.nanmax(error, initial=0.0) * 1.5))
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")


def _intervals(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def follower_picture(leader: LeaderJudgement, judged: FollowerJudgement) -> Figure:
    """A follower's fixes over the truth, and their errors along the walk."""
    plane = ground_plane(leader.truth)
    report = judged.report
    if report.wrong_building:
        figure = _figure(8, 6)
        alone = figure.subplots()
        _draw_route(alone, leader, plane)
        _draw_wrong_building(alone, judged, plane)
        alone.set_title(f"{report.name}: another building than the route's")
        alone.legend(loc="best", fontsize=9)
        return figure
    figure = _figure(12, 6)
    grid = figure.add_gridspec(2, 2, width_ratios=(1.2, 1))
    above = figure.add_subplot(grid[:, 0])
    _draw_route(above, leader, plane)
    _draw_fixes(above, judged, plane)
    above.set_title(f"{report.name}: {100 * report.relocalized_fraction:.1f} % relocalized on the route")
    above.legend(loc="best", fontsize=9)
    walked = arc_length(judged.truth.position)
    top = figure.add_subplot(grid[0, 1])
    _draw_error(top, walked, judged.position_error_m, judged, FALSE_POSITION_M)
    top.set_title("error relative to the route")
    top.set_ylabel("position, m")
    bottom = figure.add_subplot(grid[1, 1], sharex=top)
    _draw_error(bottom, walked, judged.rotation_error_deg, judged, FALSE_ROTATION_DEG)
    bottom.set_ylabel("rotation, degrees")
    bottom.set_xlabel("walked by the follower, m")
    return figure


def latency_picture(followers: Sequence[FollowerJudgement]) -> Figure:
    """Latency histograms, one row a follower, one scale for all."""
    figure = _figure(9, 1.2 + 1.9 * len(followers))
    rows = figure.subplots(len(followers), 1, sharex=True, squeeze=False)[:, 0]
    longest = max(float(judged.latency_ms.max()) for judged in followers)
    bins = np.linspace(0.0, min(max(120.0, longest * 1.02), 500.0), 61)
    for axes, judged in zip(rows, followers, strict=True):
        latency = judged.latency_ms.clip(max=bins[-1])
        fixed = judged.fixed
        axes.hist(
            [latency[fixed], latency[~fixed]], bins=bins, stacked=True, color=[FIX, REFUSED],
            label=["fix", "refused"],
        )  # fmt: skip
        figures = judged.report.latency_ms
        for value, name, side in ((figures.p50, "p50", "right"), (figures.p95, "p95", "left")):
            if value is None:
                continue
            axes.axvline(value, color="#333333", linewidth=1.1, linestyle=":")
            axes.annotate(
                f"{name} {value:.0f}",
                (value, 0.97),
                xycoords=("data", "axes fraction"),
                ha=side,
                va="top",
                xytext=(-4 if side == "right" else 4, 0),
                textcoords="offset points",
            )
        axes.set_title(judged.report.name)
        axes.set_ylabel("frames")
    rows[0].legend(loc="upper right", fontsize=9)
    rows[-1].set_xlabel("milliseconds from JPEG to update, one thread")
    return figure


def write_plots(folder: Path, leader: LeaderJudgement, followers: Sequence[FollowerJudgement]) -> list[Path]:
    """Write all pictures as PNG and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    with mpl.rc_context(STYLE):
        figures = {"leader": leader_picture(leader)}
        for judged in followers:
            name = f"follower_{judged.report.name.removeprefix('follower_')}"
            while name in figures:
                name += "_"
            figures[name] = follower_picture(leader, judged)
        if followers:
            figures["latency"] = latency_picture(followers)
        for name, figure in figures.items():
            path = folder / f"{name}.png"
            figure.savefig(path)
            written.append(path)
    return written
