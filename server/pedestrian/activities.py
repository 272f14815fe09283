"""What the legs do: walking, climbing or descending stairs, standing still.

A window of motion in level axes gives a dozen numbers that do not depend on how the phone is turned;
a multinomial logistic regression, learnt from labelled recordings, gives the probabilities.
"""

from __future__ import annotations

import json
from collections import deque
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from server.pedestrian.events import Activity
from server.pedestrian.orientation import Vector

Array = NDArray[np.float64]

ORIGIN = (
    "Parameters of pairnavi's own, under its licence: learnt by `pairnavi evaluate positioning activities` "
    "from labelled recordings of phones; nothing of a recording is in them."
)

CLASSES = (Activity.WALKING, Activity.STAIRS_UP, Activity.STAIRS_DOWN, Activity.STILL)

RATE_HZ = 50.0
WINDOW = 256
"""Samples: 5.12 s, some eight steps."""

FEATURES = (
    "log deviation of the vertical acceleration",
    "its skewness",
    "its kurtosis",
    "log deviation along the stronger level axis",
    "log deviation along the weaker level axis",
    "log deviation of the vertical jerk",
    "skewness of the vertical jerk",
    "log turning about the vertical",
    "log turning about the stronger level axis",
    "log turning in all",
    "vertical power, 0.5 to 1.3 Hz: strides",
    "vertical power, 1.3 to 2.6 Hz: steps",
    "vertical power, 2.6 to 5 Hz",
    "vertical power, 5 to 10 Hz: impacts",
    "turning power, 0.5 to 1.3 Hz",
    "turning power, 1.3 to 2.6 Hz",
    "level power, 0.5 to 1.3 Hz",
    "level power, 1.3 to 2.6 Hz",
    "vertical and level acceleration together",
    "mean frequency of the vertical power",
    "its 5 % quantile in deviations",
    "its 95 % quantile in deviations",
)

_FREQUENCIES = np.fft.rfftfreq(WINDOW, 1.0 / RATE_HZ)
_TAPER = np.hanning(WINDOW)


def _power(signal: Array) -> Array:
    return np.asarray(np.abs(np.fft.rfft((signal - signal.mean()) * _TAPER)) ** 2)


def _share(power: Array, low: float, high: float) -> float:
    inside = np.searchsorted(_FREQUENCIES, [low, high])
    return float(power[inside[0] : inside[1]].sum() / (power.sum() + 1e-9))


def _skewness(signal: Array) -> float:
    deviation = float(signal.std()) + 1e-6
    return float(((signal - signal.mean()) ** 3).mean()) / deviation**3


def features(force: Array, turning: Array) -> Array:
    """(22,) numbers as in :data:`FEATURES`.

    Args:
        force: (256, 3) specific force, m/s^2; turning: (256, 3), rad/s; both in phone axes at 50 Hz.
    """
    up = force.mean(axis=0)
    up = up / max(float(np.linalg.norm(up)), 1e-6)
    vertical = force @ up
    vertical = vertical - vertical.mean()
    level = force - np.outer(force @ up, up)
    axes = np.linalg.eigh(np.cov(level.T))[1]
    along, across = level @ axes[:, 2], level @ axes[:, 1]
    about_up = turning @ up
    about_level = turning - np.outer(about_up, up)
    swing = about_level @ np.linalg.eigh(np.cov(about_level.T))[1][:, 2]
    jerk = np.diff(vertical)
    deviation = float(vertical.std()) + 1e-6
    vertical_power, swing_power, level_power = _power(vertical), _power(swing), _power(along)
    together = np.mean(vertical * (along - along.mean())) / (deviation * (float(along.std()) + 1e-6))
    low, high = np.quantile(vertical, [0.05, 0.95]) / deviation
    return np.array(
        [
            np.log(deviation),
            _skewness(vertical),
            float((vertical**4).mean()) / deviation**4,
            np.log(along.std() + 1e-3),
            np.log(across.std() + 1e-3),
            np.log(jerk.std() + 1e-3),
            _skewness(jerk),
            np.log(np.sqrt((about_up**2).mean()) + 1e-3),
            np.log(np.sqrt((swing**2).mean()) + 1e-3),
            np.log(np.sqrt((turning**2).sum(axis=1).mean()) + 1e-3),
            _share(vertical_power, 0.5, 1.3),
            _share(vertical_power, 1.3, 2.6),
            _share(vertical_power, 2.6, 5.0),
            _share(vertical_power, 5.0, 10.0),
            _share(swing_power, 0.5, 1.3),
            _share(swing_power, 1.3, 2.6),
            _share(level_power, 0.5, 1.3),
            _share(level_power, 1.3, 2.6),
            abs(together),
            float((_FREQUENCIES * vertical_power).sum() / (vertical_power.sum() + 1e-9)),
            low,
            high,
        ]
    )


@dataclass(frozen=True, slots=True)
class ActivityModel:
    """Multinomial logistic regression on standardised features.

    Args:
        mean, deviation: (22,) of the features; beyond four deviations they are cut off.
        weights: (4, 23), of each class, the constant last.
    """

    mean: Array
    deviation: Array
    weights: Array

    def probabilities(self, values: Array) -> Array:
        """(N, 4) for features (N, 22)."""
        standard = np.clip((values - self.mean) / self.deviation, -4.0, 4.0)
        scores = standard @ self.weights[:, :-1].T + self.weights[:, -1]
        scores -= scores.max(axis=1, keepdims=True)
        odds = np.exp(scores)
        return np.asarray(odds / odds.sum(axis=1, keepdims=True))

    def to_json(self) -> dict[str, Any]:
        return {
            "origin": ORIGIN,
            "mean": [round(v, 5) for v in self.mean.tolist()],
            "deviation": [round(v, 5) for v in self.deviation.tolist()],
            "weights": [[round(v, 4) for v in row] for row in self.weights.tolist()],
        }

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> ActivityModel:
        return cls(*(np.array(document[name]) for name in ("mean", "deviation", "weights")))


@cache
def default_model() -> ActivityModel:
    """Learnt from the labelled recordings of ``pairnavi evaluate positioning activities``."""
    text = Path(__file__).with_name("activity_model.json").read_text(encoding="utf-8")
    return ActivityModel.from_json(json.loads(text))


class ActivityWatch:
    """Probabilities of the activities, once a second, over the latest window."""

    def __init__(self, model: ActivityModel, every: int = 50) -> None:
        self._model = model
        self._every = every
        self._force: deque[Vector] = deque(maxlen=WINDOW)
        self._turning: deque[Vector] = deque(maxlen=WINDOW)
        self._due = WINDOW

    def update(self, force: Vector, turning: Vector) -> Array | None:
        """One tick; (4,) probabilities in the order of :data:`CLASSES` when they are due."""
        self._force.append(force)
        self._turning.append(turning)
        self._due -= 1
        if self._due > 0:
            return None
        self._due = self._every
        values = features(np.array(self._force), np.array(self._turning))
        return np.asarray(self._model.probabilities(values[None])[0])
