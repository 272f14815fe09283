"""Colours for what has none: a scale from blue over green to yellow, readable without red and green."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_ANCHORS = np.array(
    [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], dtype=np.float64
)
"""Every quarter of matplotlib's viridis (van der Walt, Smith 2015)."""


def coloured(values: ArrayLike, low: float, high: float) -> NDArray[np.uint8]:
    """Values (N,) as colours (N, 3), red, green, blue; ``low`` and what is below is the darkest."""
    share = (np.asarray(values, dtype=np.float64) - low) / max(high - low, 1e-12)
    at = np.linspace(0.0, 1.0, len(_ANCHORS))
    channels = [np.interp(share, at, _ANCHORS[:, channel]) for channel in range(3)]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)


def coloured_by_height(positions: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Points (N, 3), z up, as colours (N, 3); the lowest and the highest twentieth share theirs."""
    if len(positions) == 0:
        return np.zeros((0, 3), np.uint8)
    low, high = np.quantile(positions[:, 2], (0.05, 0.95))
    return coloured(positions[:, 2], float(low), float(high))
