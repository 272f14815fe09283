from __future__ import annotations

import numpy as np
import pytest

from client_sim.network import NetworkConditions, SimulatedLink, links

SENT = np.arange(2000) / 10.0


def arrivals(link: SimulatedLink) -> list[float | None]:
    return [link.arrival(float(sent)) for sent in SENT]


def test_the_same_seed_gives_the_same_network_and_another_one_does_not() -> None:
    conditions = NetworkConditions(loss=0.1, delay_s=0.05, jitter_s=0.03, reorder=0.1)
    first, again, other = (links(conditions, seed) for seed in (5, 5, 6))
    up = arrivals(first[0])
    assert up == arrivals(again[0])
    assert up != arrivals(other[0])
    assert up != arrivals(first[1])


def test_a_perfect_network_delivers_at_once() -> None:
    assert arrivals(links(NetworkConditions(), 0)[0]) == list(SENT)


def test_loss_is_as_frequent_as_asked_and_independent_of_the_rest() -> None:
    lossy = arrivals(links(NetworkConditions(loss=0.2), 1)[0])
    # 2,000 draws: three standard deviations are 0.027.
    assert np.mean([a is None for a in lossy]) == pytest.approx(0.2, abs=0.027)
    both = arrivals(links(NetworkConditions(loss=0.2, delay_s=0.3, reorder=0.5), 1)[0])
    assert [a is None for a in both] == [a is None for a in lossy]


def test_jitter_alone_never_reorders_and_is_never_early() -> None:
    times = [a for a in arrivals(links(NetworkConditions(delay_s=0.05, jitter_s=0.2), 2)[0]) if a is not None]
    assert times == sorted(times)
    assert min(a - s for a, s in zip(times, SENT, strict=True)) >= 0.05


def test_reordered_messages_are_overtaken() -> None:
    times = np.array(arrivals(links(NetworkConditions(reorder=0.1), 3)[0]), dtype=float)
    held = times - SENT > 0.2
    assert held.mean() == pytest.approx(0.1, abs=0.021)
    overtaken = np.flatnonzero(held[:-3])
    assert all((times[i + 1 : i + 3] < times[i]).any() or held[i + 1 : i + 3].all() for i in overtaken)


@pytest.mark.parametrize("wrong", [{"loss": 1.1}, {"reorder": -0.1}, {"delay_s": -1}])
def test_impossible_conditions_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"fractions|negative"):
        NetworkConditions(**wrong)
