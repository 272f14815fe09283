"""Pictures of positioning: tracks on the floor map, distributions of errors, confusion matrices."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.image import imread
from numpy.typing import NDArray

from server.evaluation.positioning.mall import Floor
from server.evaluation.positioning.tracks import Track

Array = NDArray[np.float64]

TRUTH = "#5b6570"
RECKONED = "#d9822b"
ANCHORED = "#1f5fbf"


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _save(figure: Figure, file: Path) -> Path:
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)
    return file


def draw_floor(floor: Floor, tracks: Sequence[Track], anchored: Sequence[Track], file: Path) -> Path:
    """Every walk's waypoints and where it was taken to be, on the floor's map."""
    pairs = {track.walk.name: track for track in anchored}
    figure = _figure(15, 11)
    axes = figure.subplots()
    width, height = floor.size
    if floor.picture is not None:
        picture = imread(io.BytesIO(floor.picture), format="png")
        axes.imshow(picture, extent=(0, width, 0, height), alpha=0.45)
    shown = [("surveyed", TRUTH), ("dead reckoning", RECKONED)] + [("with anchors", ANCHORED)] * bool(pairs)
    for label, colour in shown:
        axes.plot([], [], color=colour, label=label)
    for track in tracks:
        waypoints = track.walk.waypoints[:, 1:]
        axes.plot(*waypoints.T, color=TRUTH, linewidth=1.0, marker=".", markersize=5)
        axes.plot(*track.path.T, color=RECKONED, linewidth=0.8)
        if track.walk.name in pairs:
            axes.plot(*pairs[track.walk.name].path.T, color=ANCHORED, linewidth=0.8)
    walked = np.concatenate([track.walk.waypoints[:, 1:] for track in tracks])
    (left, bottom), (right, top) = walked.min(axis=0) - 8.0, walked.max(axis=0) + 8.0
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal", xlabel="m", ylabel="m", title=floor.name)
    axes.legend(loc="upper right")
    return _save(figure, file)


def draw_errors(errors: Mapping[str, Array], file: Path, title: str) -> Path:
    """Cumulative distributions; a name each, metres."""
    figure = _figure(7, 4.5)
    axes = figure.subplots()
    for label, values in errors.items():
        median = float(np.median(values))
        axes.plot(np.sort(values), np.linspace(0, 1, len(values)), label=f"{label}: median {median:.2f} m")
    axes.set(xlim=(0, 12), ylim=(0, 1), xlabel="error at the waypoints, m", ylabel="fraction", title=title)
    axes.grid(color="#e6e9ec")
    axes.legend(loc="lower right")
    return _save(figure, file)


def draw_step_errors(names: Sequence[str], errors: Sequence[float], file: Path) -> Path:
    """Signed errors of the counts, percent."""
    figure = _figure(8, 4.5)
    axes = figure.subplots()
    axes.barh(range(len(names)), errors, color=ANCHORED)
    axes.set_yticks(range(len(names)), names, fontsize=8)
    axes.invert_yaxis()
    axes.axvline(0.0, color=TRUTH, linewidth=0.8)
    axes.set(xlabel="counted against true steps, %", title="Steps")
    return _save(figure, file)


def draw_confusion(matrix: Array, labels: Sequence[str], file: Path, title: str) -> Path:
    """Rows are the truth, columns what was said; shares of the row."""
    shares = matrix / np.maximum(matrix.sum(axis=1, keepdims=True), 1)
    figure = _figure(1.2 * len(labels) + 2.5, 1.0 * len(labels) + 1.8)
    axes = figure.subplots()
    axes.imshow(shares, cmap="Blues", vmin=0, vmax=1)
    for (row, column), share in np.ndenumerate(shares):
        axes.text(
            column, row, f"{100 * share:.0f} %\n{matrix[row, column]:.0f}", ha="center", va="center",
            color="white" if share > 0.5 else "black", fontsize=9,
        )  # fmt: skip
    axes.set_xticks(range(len(labels)), labels, rotation=20)
    axes.set_yticks(range(len(labels)), labels)
    axes.set(xlabel="detected", ylabel="true", title=title)
    return _save(figure, file)
