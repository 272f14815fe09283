"""Activities of people the model has never seen: leave one person out.

Files ``acc_expEE_userUU.txt`` and ``gyro_expEE_userUU.txt``: a line a sample at 50 Hz, m/s^2 and rad/s.
``labels.txt``: experiment, user, activity (1 walking, 2 stairs up, 3 stairs down, 4 sitting, 5 standing),
first and last line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from server.evaluation.positioning.folders import RecordingError, unpacked
from server.evaluation.positioning.mall import MallWalk
from server.pedestrian.activities import CLASSES, RATE_HZ, WINDOW, ActivityModel, features
from server.pedestrian.anchors import AnchorOptions, Moment, StairsDetector
from server.pedestrian.events import Activity
from server.pedestrian.resampling import MotionGrid
from server.pedestrian.samples import Accelerometer, Gyroscope

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_CODES = {
    1: Activity.WALKING,
    2: Activity.STAIRS_UP,
    3: Activity.STAIRS_DOWN,
    4: Activity.STILL,
    5: Activity.STILL,
}


NOBODY = -1
"""The person of windows that are learnt from and never judged."""


@dataclass(frozen=True, slots=True)
class LabelledWindows:
    """Features (N, F) of windows that overlap by half, class (N,) as in CLASSES, person (N,)."""

    values: Array = field(repr=False)
    classes: Indices = field(repr=False)
    people: Indices = field(repr=False)
    passages: tuple[Passage, ...] = field(repr=False, default=())
    broken_labels: int = 0


@dataclass(frozen=True, slots=True)
class Passage:
    """One labelled stretch: its class, its person, features (N, F) once a second as in the stream."""

    activity: Activity
    person: int
    values: Array = field(repr=False)


@dataclass(frozen=True, slots=True)
class ActivityReport:
    """Of people left out of the learning.

    Args:
        confusion: (4, 4) windows, rows the truth.
        stairs: for each true activity, how many stretches the detector of stairs took for what.
    """

    confusion: Array
    stairs: dict[str, dict[str, int]]
    people: int
    broken_labels: int

    @property
    def balanced_accuracy(self) -> float:
        return float(np.mean(np.diag(self.confusion) / np.maximum(self.confusion.sum(axis=1), 1)))

    def to_json(self) -> dict[str, Any]:
        return {
            "balanced_accuracy": self.balanced_accuracy,
            "classes": [activity.value for activity in CLASSES],
            "confusion": self.confusion.astype(int).tolist(),
            "stairs_detected_in_stretches": self.stairs,
            "people": self.people,
            "window_seconds": WINDOW / 50.0,
            "broken_labels": self.broken_labels,
        }


def read_windows(folder: Path) -> LabelledWindows:
    """Raises: RecordingError: no such recordings."""
    with unpacked(folder, "labels.txt") as files:
        values, classes, people, passages, broken = [], [], [], [], 0
        labels = _read_labels(files[0])
        for experiment, user, code, first, last in labels.tolist():
            force, turning = _read(files[0].parent, experiment, user)
            if code not in _CODES:
                continue
            if not first < last <= len(force):
                broken += 1
                continue
            every_second = [
                features(force[begin : begin + WINDOW], turning[begin : begin + WINDOW])
                for begin in range(first, last - WINDOW + 1, int(RATE_HZ))
            ]
            if not every_second:
                continue
            passages.append(Passage(_CODES[code], user, np.array(every_second)))
            for begin in range(first, last - WINDOW + 1, WINDOW // 2):
                window = slice(begin, begin + WINDOW)
                values.append(features(force[window], turning[window]))
                classes.append(CLASSES.index(_CODES[code]))
                people.append(user)
    if not values:
        raise RecordingError(f"{folder} has no labelled windows of {WINDOW} samples")
    if len(set(people)) < 2:
        raise RecordingError(f"{folder} has one person alone: nobody is left to learn from")
    return LabelledWindows(np.array(values), np.array(classes), np.array(people), tuple(passages), broken)


def _read_labels(file: Path) -> Indices:
    """(N, 5)."""
    try:
        rows = [
            [int(word) for word in line.split()] for line in file.read_text(encoding="utf-8").splitlines()
        ]
    except (OSError, ValueError) as error:
        raise RecordingError(f"{file}: {error}") from error
    if any(len(row) not in (0, 5) for row in rows):
        raise RecordingError(f"{file}: a line is not experiment, user, activity, first, last")
    return np.array([row for row in rows if row], dtype=np.intp).reshape(-1, 5)


def _read(folder: Path, experiment: int, user: int) -> tuple[Array, Array]:
    name = f"exp{experiment:02d}_user{user:02d}.txt"
    try:
        force, turning = (np.loadtxt(folder / f"{sensor}_{name}", ndmin=2) for sensor in ("acc", "gyro"))
    except (OSError, ValueError) as error:
        raise RecordingError(f"{folder}: {error}") from error
    return force, turning


def walking_windows(walks: Sequence[MallWalk], count: int) -> Array:
    """(N, F): at most ``count`` windows, evenly chosen, of walks on one floor with the phone in the hand."""
    values = []
    for walk in walks:
        grid = MotionGrid(1.0 / RATE_HZ)
        ticks = []
        for sample in walk.samples:
            if isinstance(sample, Accelerometer):
                ticks += grid.acceleration(sample.t, (sample.x, sample.y, sample.z))
            elif isinstance(sample, Gyroscope):
                ticks += grid.rotation(sample.t, (sample.x, sample.y, sample.z))
        force, turning = np.array([tick[1] for tick in ticks]), np.array([tick[2] for tick in ticks])
        values += [
            features(force[begin : begin + WINDOW], turning[begin : begin + WINDOW])
            for begin in range(0, len(ticks) - WINDOW + 1, WINDOW // 2)
        ]
    if not values:
        raise RecordingError("no walk is as long as a window")
    chosen = np.unique(np.linspace(0, len(values) - 1, count).astype(int))
    return np.asarray(np.array(values)[chosen])


def with_walking(windows: LabelledWindows, walking: Array) -> LabelledWindows:
    """The same with windows of walking of nobody who is left out."""
    return replace(
        windows,
        values=np.concatenate([windows.values, walking]),
        classes=np.concatenate([windows.classes, np.full(len(walking), CLASSES.index(Activity.WALKING))]),
        people=np.concatenate([windows.people, np.full(len(walking), NOBODY)]),
    )


def learn(values: Array, classes: Indices, penalty: float = 1.5) -> ActivityModel:
    """Maximum likelihood with all classes weighing the same, and a quadratic penalty on the weights."""
    mean, deviation = values.mean(axis=0), values.std(axis=0) + 1e-9
    standard = np.clip((values - mean) / deviation, -4.0, 4.0)
    inputs = np.column_stack([standard, np.ones(len(standard))])
    truth = np.eye(len(CLASSES))[classes]
    counts = np.maximum(truth.sum(axis=0), 1.0)
    weight = (len(truth) / (len(CLASSES) * counts))[classes]

    def loss(flat: Array) -> tuple[float, Array]:
        weights = flat.reshape(len(CLASSES), -1)
        scores = inputs @ weights.T
        scores -= scores.max(axis=1, keepdims=True)
        logs = scores - np.log(np.exp(scores).sum(axis=1, keepdims=True))
        shrink = np.concatenate([weights[:, :-1], np.zeros((len(CLASSES), 1))], axis=1)
        value = -float((weight[:, None] * truth * logs).sum()) + 0.5 * penalty * float((shrink**2).sum())
        slope = (weight[:, None] * (np.exp(logs) - truth)).T @ inputs + penalty * shrink
        return value, slope.ravel()

    start = np.zeros(len(CLASSES) * inputs.shape[1])
    fitted = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 2000}).x
    return ActivityModel(mean, deviation, fitted.reshape(len(CLASSES), -1))


def judge_activities(windows: LabelledWindows) -> ActivityReport:
    """Each person's windows, and stretches of stairs, by a model of all the others."""
    confusion = np.zeros((len(CLASSES), len(CLASSES)))
    stairs: dict[str, dict[str, int]] = {activity.value: {} for activity in CLASSES}
    people = np.setdiff1d(windows.people, [NOBODY])
    for person in people:
        own = windows.people == person
        model = learn(windows.values[~own], windows.classes[~own])
        said = model.probabilities(windows.values[own]).argmax(axis=1)
        np.add.at(confusion, (windows.classes[own], said), 1.0)
        for passage in windows.passages:
            if passage.person == person:
                seen = stairs[passage.activity.value]
                detected = _detected(model, passage)
                seen[detected] = seen.get(detected, 0) + 1
    return ActivityReport(confusion, stairs, len(people), windows.broken_labels)


def _detected(model: ActivityModel, passage: Passage) -> str:
    """The stairs on which the detector thinks the walker was for longest."""
    detector = StairsDetector(AnchorOptions())
    said = [CLASSES[i] for i in model.probabilities(passage.values).argmax(axis=1)]
    lasted: dict[str, float] = {}
    for t, activity in enumerate([*said, Activity.WALKING, Activity.WALKING]):
        sighting = detector.update(Moment(float(t), activity, True, 0.0, None, 0.0))
        if sighting is not None:
            lasted[sighting.kind] = lasted.get(sighting.kind, 0.0) + sighting.until - sighting.t
    return max(lasted, key=lambda kind: lasted[kind]) if lasted else "nothing"
