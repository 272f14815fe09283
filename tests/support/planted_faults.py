"""Faults planted into a walk's pictures: darkness, blur, a blank wall, at known seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Change = Callable[[Image, np.random.Generator], Image]


@dataclass(frozen=True, slots=True)
class Fault:
    """Pictures ``begin`` up to but not ``end``, changed in one way, and what it has to be called."""

    begin: int
    end: int
    reason: str
    kind: str


def _black(image: Image, rng: np.random.Generator) -> Image:
    return np.zeros_like(image)


def _dim(share: float) -> Change:
    return lambda image, rng: np.clip(image * share + rng.normal(0.0, 0.7, image.shape), 0, 255).astype(
        np.uint8
    )


def _gaussian(sigma: float) -> Change:
    return lambda image, rng: np.asarray(cv2.GaussianBlur(image, (0, 0), sigma), dtype=np.uint8)


def _directional(length: int, degrees: float) -> Change:
    kernel = np.zeros((length, length), np.float32)
    kernel[length // 2] = 1.0
    turn = cv2.getRotationMatrix2D((length / 2 - 0.5, length / 2 - 0.5), degrees, 1.0)
    kernel = np.asarray(cv2.warpAffine(kernel, turn, (length, length)), np.float32)
    kernel /= kernel.sum()
    return lambda image, rng: np.asarray(cv2.filter2D(image, -1, kernel), dtype=np.uint8)


def _wall(grey: float, noise: float, fall_off: float) -> Change:
    def change(image: Image, rng: np.random.Generator) -> Image:
        height, width = image.shape[:2]
        across, down = np.linspace(-1, 1, width)[None, :, None], np.linspace(-1, 1, height)[:, None, None]
        light = grey - fall_off * (0.7 * across**2 + 0.3 * down)
        wall = light + rng.normal(0.0, noise, (height, width, 1))
        return np.clip(np.broadcast_to(wall, image.shape), 0, 255).astype(np.uint8)

    return change


KINDS: dict[str, tuple[str, Change]] = {
    "black": ("too_dark", _black),
    "5 %": ("too_dark", _dim(0.05)),
    "10 %": ("too_dark", _dim(0.10)),
    "Gaussian 3": ("blurred", _gaussian(3.0)),
    "Gaussian 5": ("blurred", _gaussian(5.0)),
    "Gaussian 10": ("blurred", _gaussian(10.0)),
    "along 21, 0°": ("blurred", _directional(21, 0.0)),
    "along 31, 30°": ("blurred", _directional(31, 30.0)),
    "along 25, 90°": ("blurred", _directional(25, 90.0)),
    "wall 200": ("blank_wall", _wall(200.0, 3.0, 0.0)),
    "wall 140, fall-off": ("blank_wall", _wall(140.0, 2.0, 25.0)),
    "wall 225, noise 8": ("blank_wall", _wall(225.0, 8.0, 10.0)),
}
"""By name: what the fault has to be called, and what it does to a picture (H, W, 3)."""


def plant(pictures: Sequence[Image], faults: Sequence[Fault], rng: np.random.Generator) -> Iterator[Image]:
    """The pictures (H, W, 3) with the faults in them."""
    for row, picture in enumerate(pictures):
        here = next((fault for fault in faults if fault.begin <= row < fault.end), None)
        yield picture if here is None else KINDS[here.kind][1](picture, rng)


def draw_faults(
    count: int, fps: float, seconds: float, rng: np.random.Generator, *, adjacent: bool = False
) -> list[Fault]:
    """One fault of every reason in random order, of random kinds, at random places of a walk.

    Args:
        count: pictures of the walk; seconds: how long each fault lasts.
        adjacent: whether the first two follow each other at once.
    """
    reasons = rng.permutation(["too_dark", "blurred", "blank_wall"])
    length, margin = round(seconds * fps), round(1.5 * fps)
    gaps = [0 if adjacent else margin, margin]
    slack = count - 3 * length - sum(gaps) - 2 * margin
    if slack < 0:
        raise ValueError("the walk is too short for three such faults")
    before, between, _ = np.sort(rng.integers(0, slack + 1, 3))
    starts = [margin + int(before)]
    starts.append(starts[0] + length + gaps[0] + (0 if adjacent else int(between - before)))
    starts.append(starts[1] + length + gaps[1] + (int(between - before) if adjacent else 0))
    faults = []
    for start, reason in zip(starts, reasons, strict=True):
        kind = str(rng.choice([name for name, (called, _) in KINDS.items() if called == reason]))
        faults.append(Fault(start, start + length, str(reason), kind))
    return faults
