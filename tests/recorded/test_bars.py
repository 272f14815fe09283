"""The figures that route maps and followers must reach on the recorded walks, judged as ``evaluate`` does.

Times are not judged here: tests share their machine.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from server.evaluation.follower import judge_follower
from server.evaluation.isolated import ONE_THREAD, run_isolated
from server.evaluation.leader import BuildFigures, LeaderJudgement, judge_leader
from server.evaluation.report import FollowerReport
from server.evaluation.runs import build_map, follow_route
from server.evaluation.walk import Walk, read_walk
from server.mapping.codec import load_route_map, save_route_map
from server.mapping.exchange.colmap_export import write_colmap
from server.mapping.exchange.colmap_import import image_times, import_colmap, read_colmap
from server.mapping.outcome import BuildReport

pytestmark = pytest.mark.recorded


@dataclass(frozen=True, eq=False)
class _Route:
    leader: Walk
    map_file: Path
    judgement: LeaderJudgement

    def follow(self, walk: Walk) -> FollowerReport:
        answers = run_isolated(follow_route, self.map_file, walk.video, walk.camera, environment=ONE_THREAD)
        return judge_follower(self.leader, self.judgement, walk, answers).report


def _route(walks: Path, name: str, folder: Path) -> _Route:
    leader = read_walk(walks / name / "leader")
    map_file = folder / f"{name}.map"
    build = run_isolated(build_map, leader.video, leader.camera, map_file)
    assert build.map_bytes > 0, build.detail
    return _Route(leader, map_file, judge_leader(leader, load_route_map(map_file), build))


@pytest.fixture(scope="module")
def walks(recorded_data: Path) -> Path:
    """Folder of the recorded walks."""
    return recorded_data / "walks"


@pytest.fixture(scope="module")
def kitchen(walks: Path, tmp_path_factory: pytest.TempPathFactory) -> _Route:
    """The kitchen's map, built once."""
    return _route(walks, "kitchen", tmp_path_factory.mktemp("kitchen"))


@pytest.fixture(scope="module")
def house(walks: Path, tmp_path_factory: pytest.TempPathFactory) -> _Route:
    """The house's map, built once."""
    return _route(walks, "house", tmp_path_factory.mktemp("house"))


def test_the_kitchen_is_mapped(kitchen: _Route) -> None:
    report = kitchen.judgement.report
    assert report.tracked_fraction >= 0.98
    assert report.ate_rmse_m is not None
    assert report.ate_rmse_m <= 0.06
    # The two cameras of the recording are rigidly mounted: what is taken off is their angle, no more.
    assert report.camera_offset_deg < 6.0


def test_the_house_is_mapped(house: _Route) -> None:
    report = house.judgement.report
    assert report.tracked_fraction >= 0.98
    assert report.ate_percent_of_path is not None
    assert report.ate_percent_of_path <= 1.5


def test_a_follower_is_found_in_the_kitchen(kitchen: _Route, walks: Path) -> None:
    report = kitchen.follow(read_walk(walks / "kitchen" / "follower"))
    assert report.relocalized_fraction >= 0.97
    assert report.position_error_m.median is not None
    assert report.position_error_m.median <= 0.08
    assert report.false_fixes == 0


def test_a_follower_is_guided_through_the_house(house: _Route, walks: Path) -> None:
    report = house.follow(read_walk(walks / "house" / "follower_same_day"))
    assert report.relocalized_fraction >= 0.97
    error = report.position_error_m
    assert error.median is not None
    assert error.p90 is not None
    assert error.median <= 0.08
    assert error.p90 <= 0.25
    assert report.hint_agreement is not None
    assert report.hint_agreement >= 0.85
    assert report.arrived
    # With the kitchen's and this one's together, the changed house below may have two.
    assert report.false_fixes == 0


def test_the_house_mapped_anew_from_its_export_guides_as_well(
    house: _Route, walks: Path, tmp_path: Path
) -> None:
    write_colmap(
        load_route_map(house.map_file), tmp_path, video=house.leader.video, camera=house.leader.camera
    )
    model = read_colmap(tmp_path)
    route_map = import_colmap(model, tmp_path / "images", image_times(model, None))
    save_route_map(route_map, tmp_path / "again.map")
    figures = BuildFigures("ready", "", BuildReport(len(route_map.path), len(route_map.path)), 0.0, 0, 0)
    again = _Route(house.leader, tmp_path / "again.map", judge_leader(house.leader, route_map, figures))
    report = again.follow(read_walk(walks / "house" / "follower_same_day"))
    assert report.relocalized_fraction >= 0.97
    assert report.position_error_m.median is not None
    assert report.position_error_m.median <= 0.08
    assert report.false_fixes == 0


def test_a_house_that_has_changed_is_still_recognised(house: _Route, walks: Path) -> None:
    report = house.follow(read_walk(walks / "house" / "follower_week1"))
    assert report.relocalized_fraction >= 0.95
    assert report.false_fixes <= 2


def test_another_building_is_never_taken_for_the_house(house: _Route, walks: Path) -> None:
    report = house.follow(read_walk(walks / "kitchen" / "follower"))
    assert report.wrong_building
    assert report.false_fixes == 0
    assert not report.arrived
    assert sum(report.refusals.values()) == report.frames
