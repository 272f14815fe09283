"""Builders that want more than they get: each obeys the video's first bytes, in the real build process."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable

import numpy as np

from server.queues.jobs import BuildOrder, BuildOutcome, JobProgress


def build(order: BuildOrder, on_progress: Callable[[JobProgress], None]) -> BuildOutcome:
    """``numpy`` and ``opencv`` take memory without end, ``disk`` finds no room, ``sleep`` says nothing."""
    command = order.video.read_text(encoding="ascii")
    on_progress(JobProgress("tracking", 0.25))
    taken = []
    if command == "numpy":
        while True:
            taken.append(np.ones(16 << 20, np.uint8))
    if command == "opencv":
        import cv2

        grey = np.zeros((4096, 4096), np.uint8)
        while True:
            taken.append(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    if command == "disk":
        raise OSError(errno.ENOSPC, "No space left on device")
    time.sleep(60)
    return BuildOutcome("tracking_lost", "slept")
