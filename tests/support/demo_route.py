"""The demo's synthetic walks and the leader's map, for all tests that need a real map."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from client_sim.synthetic.small_walks import write_small_walks
from server.evaluation.leader import BuildFigures, LeaderJudgement, judge_leader
from server.evaluation.walk import Walk, read_walk
from server.mapping.build import build_route_map
from server.mapping.codec import save_route_map
from server.mapping.outcome import BuildProgress, BuildResult
from server.mapping.route_map import RouteMap


@dataclass(frozen=True, eq=False)
class DemoRoute:
    """Walks, map and what was told while it was built.

    Attributes:
        route_map: as it was built; map_file: as it was written.
        judgement: of the leader, and how the map lies in the truth.
    """

    leader: Walk
    follower: Walk
    result: BuildResult
    progress: tuple[BuildProgress, ...]
    route_map: RouteMap
    map_file: Path
    judgement: LeaderJudgement


def judged(walk: Walk, result: BuildResult) -> LeaderJudgement:
    """A build that gave a map, against the walk's truth."""
    assert result.route_map is not None, result.detail
    figures = BuildFigures(result.status, result.detail, result.report, 0.0, 0, 0)
    return judge_leader(walk, result.route_map, figures)


def build_demo_route(folder: Path) -> DemoRoute:
    """Render, build, write, judge."""
    leader, follower = (read_walk(walk) for walk in write_small_walks(folder))
    told: list[BuildProgress] = []
    result = build_route_map(leader.video, leader.camera, on_progress=told.append)
    assert result.route_map is not None, result.detail
    map_file = folder / "route.map"
    save_route_map(result.route_map, map_file)
    return DemoRoute(
        leader, follower, result, tuple(told), result.route_map, map_file, judged(leader, result)
    )
