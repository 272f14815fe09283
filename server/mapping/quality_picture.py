"""The quality report as one picture for a page: verdict, timeline, path from above, the weak stretches."""

from __future__ import annotations

import textwrap
from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle, Wedge
from numpy.typing import NDArray

from server.mapping.quality import GOOD_SCORE, QualityReport, WeakStretch
from server.mapping.weak_stretches import WeakReason

Array = NDArray[np.float64]

INK = "#22303c"
FAINT = "#6b7884"
LINE = "#dfe4e8"
CARD = "#f5f7f9"
GOOD = "#009e73"
FAIR = "#e69f00"
POOR = "#d55e00"

COLOURS: dict[WeakReason, str] = {
    WeakReason.TOO_DARK: "#332288",
    WeakReason.TOO_BRIGHT: "#ddcc77",
    WeakReason.LENS_COVERED: "#882255",
    WeakReason.BLANK_WALL: "#e69f00",
    WeakReason.BLURRED: "#0072b2",
    WeakReason.TOO_FAST: "#d55e00",
    WeakReason.TOO_MUCH_MOTION: "#cc79a7",
    WeakReason.LOST: "#5b6570",
}
"""Colours that colour-blind people can tell apart (Okabe, Ito 2008; Tol 2021); numbers say the same."""

TITLES: dict[WeakReason, str] = {
    WeakReason.TOO_DARK: "Too dark",
    WeakReason.TOO_BRIGHT: "Too bright",
    WeakReason.LENS_COVERED: "Lens covered",
    WeakReason.BLANK_WALL: "Blank wall",
    WeakReason.BLURRED: "Blurred",
    WeakReason.TOO_FAST: "Too fast",
    WeakReason.TOO_MUCH_MOTION: "Too much motion",
    WeakReason.LOST: "Lost",
}

MOST_CARDS = 6
"""Stretches with a card of their own, the worst ones; the others are on the timeline."""

_DPI = 110
_WIDTH = 13.0
_MARGIN = 0.45
_HEADER = 1.75
_TIMELINE = 1.75
_MIDDLE = 0.75
_CARD_HEIGHT = 1.75
_CARD_GAP = 0.22
_COLUMNS = 2
_PATH_HEIGHT = 5.0


def draw_quality_report(report: QualityReport, target: Path, title: str = "The walk") -> None:
    """Write the PNG of a report, 1430 pixels wide, as high as it has to be.

    Raises:
        OSError: the file cannot be written.
    """
    worst = sorted(enumerate(report.stretches, 1), key=lambda item: -_weight(item[1]))[:MOST_CARDS]
    cards = sorted(worst, key=lambda item: item[0])
    mapped = report.timeline.position is not None
    columns = 1 if mapped else _COLUMNS
    rows = -(-len(cards) // columns)
    below = max(rows * (_CARD_HEIGHT + _CARD_GAP) - _CARD_GAP, 4.2 if mapped else 0.0)
    note_lines = 0.28 * len(_notes(report, len(cards)))
    height = _MARGIN + _HEADER + _TIMELINE + _MIDDLE + below + note_lines + _MARGIN
    with mpl.rc_context({"font.family": "DejaVu Sans", "text.color": INK, "axes.edgecolor": LINE}):
        figure = Figure(figsize=(_WIDTH, height), dpi=_DPI, facecolor="white")
        FigureCanvasAgg(figure)
        top = height - _MARGIN
        _draw_header(_canvas(figure, _MARGIN, top - _HEADER, _WIDTH - 2 * _MARGIN, _HEADER), report, title)
        top -= _HEADER + _TIMELINE
        _draw_timeline(_canvas(figure, _MARGIN + 0.75, top, _WIDTH - 2 * _MARGIN - 0.75, _TIMELINE), report)
        top -= _MIDDLE
        width = _WIDTH - 2 * _MARGIN
        if mapped:
            width = 0.5 * width - 0.3
            left = _MARGIN + width + 0.6
            high = min(below, _PATH_HEIGHT)
            _draw_path(_canvas(figure, left, top - high, width, high), report)
        if cards:
            each = (width - (columns - 1) * 0.3) / columns
            for place, (number, stretch) in enumerate(cards):
                row, column = divmod(place, columns)
                left = _MARGIN + column * (each + 0.3)
                bottom = top - row * (_CARD_HEIGHT + _CARD_GAP) - _CARD_HEIGHT
                _draw_card(_canvas(figure, left, bottom, each, _CARD_HEIGHT), number, stretch, each)
        elif mapped:
            _draw_nothing_weak(_canvas(figure, _MARGIN, top - below, width, below))
        for line, note in enumerate(_notes(report, len(cards))):
            _text(figure, _MARGIN, top - below - 0.28 * (line + 1), note)
        figure.savefig(target, dpi=_DPI)


def _weight(stretch: WeakStretch) -> float:
    return stretch.severity * (stretch.end_s - stretch.start_s)


def _notes(report: QualityReport, cards: int) -> list[str]:
    more = len(report.stretches) - cards
    left = [f"{more} shorter stretches are marked on the timeline only."] if more > 0 else []
    notes = [*left, *report.notes]
    return notes if len(notes) <= 4 else [*notes[:3], f"… and {len(notes) - 3} more notes of this kind."]


def _canvas(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Axes at a place in inches."""
    across, up = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / up, width / across, height / up))


def _text(figure: Figure, left: float, bottom: float, text: str) -> None:
    across, up = figure.get_size_inches()
    figure.text(left / across, bottom / up, text, fontsize=9.5, color=FAINT)


def _inches(axes: Axes, width: float, height: float) -> None:
    """Make the axes' unit an inch, nothing of them drawn."""
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)
    axes.axis("off")


def _draw_header(axes: Axes, report: QualityReport, title: str) -> None:
    width = _WIDTH - 2 * _MARGIN
    _inches(axes, width, _HEADER)
    colour = POOR if report.record_again else GOOD if report.score >= 90 else FAIR
    centre, radius = (0.72, 1.05), 0.62
    axes.add_patch(Wedge(centre, radius, 0, 360, width=0.13, color=LINE, linewidth=0))
    turn = 360.0 * report.score / 100.0
    axes.add_patch(Wedge(centre, radius, 90 - turn, 90, width=0.13, color=colour, linewidth=0))
    axes.text(*centre, str(report.score), fontsize=25, fontweight="bold", ha="center", va="center_baseline")
    axes.text(centre[0], centre[1] - 0.36, "of 100", fontsize=7.5, color=FAINT, ha="center", va="center")
    axes.text(1.65, 1.50, title, fontsize=11, color=FAINT, va="center")
    lines = textwrap.wrap(report.verdict, 84)[:2]
    for row, line in enumerate(lines):
        axes.text(1.65, 1.18 - 0.3 * row, line, fontsize=15, fontweight="bold", va="center")
    weak = sum(s.end_s - s.start_s for s in report.stretches)
    kind = "of the way" if report.timeline.position is not None else "of the time, and no map"
    facts = (
        f"{report.video_seconds:.1f} s of video   ·   {100 * report.coverage:.0f} % {kind} covered   ·   "
        f"{_counted(len(report.stretches))}{f', {weak:.1f} s' if report.stretches else ''}   ·   "
        f"{GOOD_SCORE} and more are worth keeping"
    )
    axes.text(1.65, 1.18 - 0.3 * len(lines) - 0.04, facts, fontsize=10, color=FAINT, va="center")


def _counted(stretches: int) -> str:
    return "no weak stretch" if stretches == 0 else f"{stretches} weak stretch{'es' if stretches > 1 else ''}"


def _draw_timeline(axes: Axes, report: QualityReport) -> None:
    timeline = report.timeline
    seconds = report.video_seconds
    time = np.append(timeline.time, seconds)
    landmarks = np.append(timeline.landmarks, timeline.landmarks[-1:]).astype(np.float64)
    top = 1.25 * max(float(np.percentile(landmarks, 98)), 100.0)
    strip = 0.1 * top
    axes.fill_between(time, landmarks, step="post", color="#b9c8d4", linewidth=0)
    covered = np.append(timeline.covered, timeline.covered[-1:])
    axes.fill_between(time, -2 * strip, -strip, step="post", color="#eceff2", linewidth=0)
    axes.fill_between(
        time, -2 * strip, -strip, where=list(covered), step="post", color=GOOD, alpha=0.75, linewidth=0
    )
    last, row = -np.inf, 0
    for number, stretch in enumerate(report.stretches, 1):
        colour = COLOURS[stretch.reason]
        span = max(stretch.end_s - stretch.start_s, 0.004 * seconds)
        axes.add_patch(
            Rectangle(
                (stretch.start_s, -2 * strip), span, top + 2 * strip, color=colour, alpha=0.22, linewidth=0
            )
        )
        axes.add_patch(
            Rectangle((stretch.start_s, -2 * strip), span, strip, color=colour, linewidth=0, zorder=3)
        )
        middle = stretch.start_s + span / 2
        # Badges of neighbours step up rather than overlap.
        row = (row + 1) % 3 if middle - last < 0.028 * seconds else 0
        last = middle
        _badge(axes, middle, top * (1.02 - 0.17 * row), number, colour)
    axes.set_xlim(0, seconds)
    axes.set_ylim(-2 * strip, 1.15 * top)
    ticks = [tick for tick in axes.get_yticks() if 0 <= tick <= top]
    axes.set_yticks([*ticks[::2], -1.5 * strip], [*(f"{tick:.0f}" for tick in ticks[::2]), "covered"])
    axes.tick_params(length=0, labelsize=9, labelcolor=FAINT)
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_title("Landmarks in view", loc="left", fontsize=10, color=FAINT, pad=8)
    axes.set_xlabel("seconds of the video", fontsize=9, color=FAINT, labelpad=2)


def _badge(axes: Axes, x: float, y: float, number: int, colour: str) -> None:
    axes.text(
        x,
        y,
        str(number),
        fontsize=9,
        fontweight="bold",
        color="white",
        ha="center",
        va="center",
        zorder=6,
        bbox={"boxstyle": "circle,pad=0.28", "facecolor": colour, "edgecolor": "white", "linewidth": 1.0},
    )


def _draw_card(axes: Axes, number: int, stretch: WeakStretch, width: float) -> None:
    _inches(axes, width, _CARD_HEIGHT)
    colour = COLOURS[stretch.reason]
    axes.add_patch(
        FancyBboxPatch(
            (0.06, 0.06),
            width - 0.12,
            _CARD_HEIGHT - 0.12,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor=CARD,
            edgecolor=LINE,
            linewidth=1.0,
        )
    )
    axes.add_patch(Rectangle((0.06, 0.06), 0.09, _CARD_HEIGHT - 0.12, color=colour, linewidth=0))
    left = 0.33
    picture = _decoded(stretch.thumbnail)
    if picture is not None:
        high = _CARD_HEIGHT - 0.36
        wide = min(high * picture.shape[1] / picture.shape[0], 2.2)
        high = wide * picture.shape[0] / picture.shape[1]
        low = (_CARD_HEIGHT - high) / 2
        axes.imshow(
            picture, extent=(left, left + wide, low, low + high), cmap="gray", vmin=0, vmax=255, zorder=2
        )
        axes.set_xlim(0, width)
        axes.set_ylim(0, _CARD_HEIGHT)
        axes.set_aspect("auto")
        left += wide + 0.25
    _badge(axes, left + 0.1, _CARD_HEIGHT - 0.36, number, colour)
    axes.text(
        left + 0.32,
        _CARD_HEIGHT - 0.37,
        TITLES[stretch.reason],
        fontsize=12.5,
        fontweight="bold",
        va="center",
    )
    axes.text(
        width - 0.22,
        _CARD_HEIGHT - 0.37,
        f"{stretch.start_s:.1f} – {stretch.end_s:.1f} s",
        fontsize=10.5,
        color=FAINT,
        ha="right",
        va="center",
    )
    seen, _, advice = stretch.detail.partition(": ")
    room = max(18, int((width - left - 0.2) / 0.08))
    lines = [(line, INK) for line in textwrap.wrap(f"{seen}.", room)]
    lines += [(line, FAINT) for line in textwrap.wrap(advice[:1].upper() + advice[1:], room)]
    for row, (line, ink) in enumerate(lines[:5]):
        axes.text(left, _CARD_HEIGHT - 0.72 - 0.2 * row, line, fontsize=9.5, color=ink, va="center")


def _decoded(thumbnail: bytes | None) -> NDArray[np.uint8] | None:
    if not thumbnail:
        return None
    picture = cv2.imdecode(np.frombuffer(thumbnail, np.uint8), cv2.IMREAD_GRAYSCALE)
    return None if picture is None else np.asarray(picture, dtype=np.uint8)


def _draw_nothing_weak(axes: Axes) -> None:
    axes.axis("off")
    axes.text(0.5, 0.5, "No weak stretch was found.", fontsize=14, color=FAINT, ha="center", va="center")


def _draw_path(axes: Axes, report: QualityReport) -> None:
    """The path from above: green where covered, in its reason's colour where weak."""
    position = report.timeline.position
    if position is None:
        return
    time, line = report.timeline.time, position[:, :2]
    pieces = np.stack([line[:-1], line[1:]], axis=1)
    covered = report.timeline.covered[:-1] & report.timeline.covered[1:]
    axes.add_collection(LineCollection(list(pieces), colors=LINE, linewidths=9, capstyle="round", zorder=1))
    axes.add_collection(
        LineCollection(list(pieces[covered]), colors=GOOD, linewidths=4, capstyle="round", zorder=2)
    )
    for number, stretch in enumerate(report.stretches, 1):
        rows = np.flatnonzero((time >= stretch.start_s - 1e-6) & (time < stretch.end_s))
        colour = COLOURS[stretch.reason]
        axes.plot(*line[rows].T, color=colour, linewidth=6, solid_capstyle="round", zorder=3)
        x, y = line[rows[len(rows) // 2]]
        _badge(axes, float(x), float(y), number, colour)
    for point, label, marker in ((line[0], "start", "o"), (line[-1], "destination", "s")):
        axes.plot(
            *point, marker, color="white", markeredgecolor=INK, markersize=9, markeredgewidth=2, zorder=5
        )
        axes.annotate(
            label,
            tuple(point),
            xytext=(10, 9 if marker == "o" else -15),
            textcoords="offset points",
            fontsize=10,
            zorder=7,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    axes.margins(0.12)
    axes.set_xticks([])
    axes.set_yticks([])
    for side in axes.spines.values():
        side.set_visible(False)
    axes.set_title("The path from above", loc="left", fontsize=10, color=FAINT)
