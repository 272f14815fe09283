"""The demo's walks, judged as ``pairnavi evaluate route`` does: what is promised on a terminal must hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from client_sim.synthetic.demo import COVERED, DemoWalks
from client_sim.synthetic.walk_folders import write_recording
from server.evaluation.follower import judge_follower
from server.evaluation.isolated import ONE_THREAD, run_isolated
from server.evaluation.leader import judge_leader
from server.evaluation.runs import build_map, follow_route
from server.evaluation.walk import read_walk
from server.mapping.codec import load_route_map


def test_the_follower_is_refused_in_the_dark_found_again_and_arrives(tmp_path: Path) -> None:
    walks = DemoWalks()
    write_recording(tmp_path / "leader", walks.leader)
    # Five pictures a second rather than ten: half the rendering, and harder to follow.
    write_recording(tmp_path / "follower", replace(walks.follower, fps=5.0))
    leader, follower = read_walk(tmp_path / "leader"), read_walk(tmp_path / "follower")
    map_file = tmp_path / "route.map"
    build = run_isolated(build_map, leader.video, leader.camera, map_file)
    assert build.map_bytes > 0, build.detail
    judgement = judge_leader(leader, load_route_map(map_file), build)
    assert judgement.report.tracked_fraction >= 0.99
    assert judgement.report.ate_percent_of_path is not None
    assert judgement.report.ate_percent_of_path <= 1.0
    answers = run_isolated(follow_route, map_file, follower.video, follower.camera, environment=ONE_THREAD)
    judged = judge_follower(leader, judgement, follower, answers)
    dark = np.array([time in COVERED for time in judged.truth.time])
    assert dark.sum() == 10
    assert not judged.fixed[dark].any()
    # A second for the exposure to find back to the light.
    late = (judged.truth.time >= COVERED.end) & (judged.truth.time < COVERED.end + 1.2)
    assert judged.fixed[~dark & ~late].mean() >= 0.97
    assert judged.report.false_fixes == 0
    assert judged.report.arrived
    assert judged.report.premature_arrivals == 0
