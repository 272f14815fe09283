"""Steps counted against a device that counted them on the foot: the Oxford step counter's traces.

One CSV file a trace: nanoseconds, acceleration (x, y, z; m/s^2), steps by their algorithm, by the device on
the foot (the truth), by the phone's hardware. The name says ``user_position_start``.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from server.evaluation.positioning.folders import RecordingError, unpacked
from server.pedestrian.events import Step
from server.pedestrian.samples import Accelerometer
from server.pedestrian.stream import PhoneStream

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class StepTrace:
    """One trace: (N, 4) seconds and acceleration; when true steps were made, (S,) seconds."""

    name: str
    samples: Array
    truth: Array


@dataclass(frozen=True, slots=True)
class TraceFigures:
    """Steps counted in one trace; ``matched``: those within half a step of a true one."""

    name: str
    true_steps: int
    counted: int
    error_percent: float
    matched: int


@dataclass(frozen=True, slots=True)
class StepReport:
    """Of all traces; errors are absolute values of (counted - true) / true."""

    traces: tuple[TraceFigures, ...]
    core_percent: float

    @property
    def errors(self) -> list[float]:
        return [abs(t.error_percent) for t in self.traces]

    def to_json(self) -> dict[str, Any]:
        return {
            "median_error_percent": statistics.median(self.errors),
            "worst_error_percent": max(self.errors),
            "traces": [asdict(trace) for trace in self.traces],
            "core_percent": self.core_percent,
        }


def read_trace(file: Path) -> StepTrace:
    """Raises: RecordingError: not such a file."""
    try:
        if not file.read_text(encoding="utf-8").strip():
            raise ValueError("it is empty")
        rows = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError) as error:
        raise RecordingError(f"{file} is not a trace of numbers: {error}") from error
    if rows.shape[1] < 6 or len(rows) < 2:
        raise RecordingError(f"{file} has {rows.shape[1]} columns, a trace has 7")
    if not np.isfinite(rows[:, :6]).all() or (np.diff(rows[:, 5]) < 0.0).any() or rows[0, 5] < 0.0:
        raise RecordingError(f"{file} is not a trace: a number is missing, or its count of steps falls")
    t = (rows[:, 0] - rows[0, 0]) * 1e-9
    count = np.diff(rows[:, 5], prepend=0.0)
    return StepTrace(file.stem, np.column_stack([t, rows[:, 1:4]]), np.repeat(t, count.astype(int)))


def count_steps(trace: StepTrace) -> tuple[Array, float]:
    """Times of the counted steps (K,), and processor seconds it took."""
    stream = PhoneStream()
    samples = [Accelerometer(*row) for row in trace.samples.tolist()]
    begin = time.process_time()
    steps = [event.t for sample in samples for event in stream.push(sample) if isinstance(event, Step)]
    return np.array(steps), time.process_time() - begin


def judge_trace(trace: StepTrace, counted: Array) -> TraceFigures:
    truth = len(trace.truth)
    error = 100.0 * (len(counted) - truth) / truth if truth else 0.0
    return TraceFigures(trace.name, truth, len(counted), error, _matched(trace.truth, counted))


def _matched(truth: Array, counted: Array, within: float = 0.3) -> int:
    """Pairs, each step used once, both in order; the foot's clock may lead or lag by a constant."""
    if len(truth) == 0 or len(counted) == 0:
        return 0
    best = 0
    for lag in np.arange(-0.6, 0.61, 0.05):
        i = j = pairs = 0
        while i < len(truth) and j < len(counted):
            apart = counted[j] + lag - truth[i]
            pairs += bool(abs(apart) <= within)
            i, j = i + (apart >= -within), j + (apart <= within)
        best = max(best, pairs)
    return best


def judge_steps(folder: Path) -> StepReport:
    """Count the steps of every trace below ``folder``.

    Raises:
        RecordingError: there is none.
    """
    with unpacked(folder, "*.csv") as files:
        traces = [read_trace(file) for file in files]
    figures, used, lasted = [], 0.0, 0.0
    for trace in traces:
        counted, seconds = count_steps(trace)
        figures.append(judge_trace(trace, counted))
        used += seconds
        lasted += float(trace.samples[-1, 0])
    return StepReport(tuple(figures), 100.0 * used / lasted)
