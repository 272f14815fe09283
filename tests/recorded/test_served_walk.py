"""The whole way: the real command serves, the reference phone leads and follows at true speed."""

from __future__ import annotations

from pathlib import Path

import pytest

from client_sim.demo import child_service
from client_sim.follower import FollowerOptions, follow
from client_sim.leader import LeaderOptions, lead
from client_sim.service import ServiceClient
from client_sim.walk import Walk
from server.evaluation.isolated import ONE_THREAD, run_isolated
from server.evaluation.runs import build_map, follow_route
from server.evaluation.walk import read_walk

pytestmark = pytest.mark.recorded


async def test_a_follower_over_the_network_is_found_as_often_as_without(
    recorded_data: Path, tmp_path: Path
) -> None:
    kitchen = recorded_data / "walks" / "kitchen"
    leader, follower = (Walk.from_folder(kitchen / name) for name in ("leader", "follower"))
    async with (
        child_service(tmp_path / "data", tmp_path / "service.log") as url,
        ServiceClient(url) as service,
    ):
        route = await lead(service, leader, LeaderOptions())
        assert route.state == "ready"
        outcome = await follow(url, route.id, follower, FollowerOptions(speed=1.0))
    summary = outcome.summary()
    assert summary.frames == pytest.approx(167, abs=1)
    assert summary.reconnections == 0
    assert summary.answered >= 0.97 * summary.frames
    assert summary.age_p95_ms is not None
    assert summary.age_p95_ms <= 200.0
    # True speed: 16.7 s of walk are sent in 16.7 s.
    assert 16.0 < summary.seconds < 25.0

    map_file = tmp_path / "kitchen.map"
    run_isolated(build_map, leader.video, read_walk(kitchen / "leader").camera, map_file)
    answers = run_isolated(
        follow_route, map_file, follower.video, read_walk(kitchen / "follower").camera, environment=ONE_THREAD
    )
    alone = sum(answer.update.fix is not None for answer in answers) / len(answers)
    assert summary.relocalized_fraction >= alone - 0.03
