"""Processes of their own: results, progress, environment, failures."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest

from server.evaluation.isolated import ONE_THREAD, IsolatedError, peak_rss_bytes, run_isolated


def _work(number: int, report: Callable[[int], None]) -> tuple[int, str | None]:
    for step in range(number):
        report(step)
    return number * number, os.environ.get("OMP_NUM_THREADS")


def _fail(report: Callable[[int], None]) -> None:
    raise ValueError("planted")


def _die(report: Callable[[int], None]) -> None:
    os._exit(7)


def test_result_progress_and_environment() -> None:
    before = os.environ.get("OMP_NUM_THREADS")
    seen: list[int] = []
    assert run_isolated(_work, 3, environment=ONE_THREAD, on_progress=seen.append) == (9, "1")
    assert seen == [0, 1, 2]
    assert os.environ.get("OMP_NUM_THREADS") == before


def test_an_exception_comes_back_with_its_traceback() -> None:
    with pytest.raises(IsolatedError, match="planted"):
        run_isolated(_fail)


def test_a_death_is_told() -> None:
    with pytest.raises(IsolatedError, match="ended with code 7"):
        run_isolated(_die)


def test_peak_memory_is_of_this_process() -> None:
    assert 10e6 < peak_rss_bytes() < 50e9
