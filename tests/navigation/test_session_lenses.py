"""Sessions of phones whose lens is unknown, whose pictures turn with them, or that look through a fisheye."""

from __future__ import annotations

import json
from collections.abc import Sequence

import cv2
import numpy as np
import pytest
from demo_route import DemoRoute

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import LensCamera, Pose
from client_sim.synthetic.rendering import Light, Renderer
from server.evaluation.follower import AnsweredFrame, judge_follower
from server.geometry.cameras import Camera
from server.geometry.poses import SE3
from server.mapping.video import VideoFrame, read_frames
from server.navigation.lens import LensBelief
from server.navigation.session import NavigationSession, SessionSnapshot
from server.navigation.updates import Update


@pytest.fixture(scope="module")
def frames(demo_route: DemoRoute) -> list[VideoFrame]:
    """The follower's pictures."""
    return list(read_frames(demo_route.follower.video))


def _learnt(session: NavigationSession) -> LensBelief:
    belief = session.snapshot().lens
    assert belief is not None
    return belief


def _judged(demo_route: DemoRoute, updates: Sequence[Update]) -> tuple[float, int, float]:
    """Share of the frames that were fixed, false fixes, median error in metres."""
    answers = [AnsweredFrame(k, update, 0.0) for k, update in enumerate(updates)]
    report = judge_follower(demo_route.leader, demo_route.judgement, demo_route.follower, answers).report
    assert report.position_error_m.median is not None
    return report.relocalized_fraction, report.false_fixes, report.position_error_m.median


def test_a_follower_whose_camera_is_unknown_is_found_as_well(
    demo_route: DemoRoute, frames: list[VideoFrame]
) -> None:
    session = NavigationSession(demo_route.route_map, None)
    updates = [session.process(f.image, f.time, k) for k, f in enumerate(frames)]
    relocalized, false_fixes, error = _judged(demo_route, updates)
    assert relocalized >= 0.99
    assert false_fixes == 0
    assert error < 0.04
    belief = _learnt(session)
    assert belief.settled
    assert belief.camera.focal[0] == pytest.approx(540.0, rel=0.01)


def test_what_was_learnt_is_resumed(demo_route: DemoRoute, frames: list[VideoFrame]) -> None:
    first = NavigationSession(demo_route.route_map, None)
    for k, frame in enumerate(frames[:25]):
        first.process(frame.image, frame.time, k)
    snapshot = SessionSnapshot.from_json(json.loads(json.dumps(first.snapshot().to_json())))
    assert snapshot == first.snapshot()
    second = NavigationSession(demo_route.route_map, None, snapshot=snapshot)
    update = second.process(frames[25].image, frames[25].time, 25)
    assert update.fix is not None
    assert _learnt(second).focal_sigma <= _learnt(first).focal_sigma < 0.05
    assert _learnt(second).camera.focal[0] == pytest.approx(_learnt(first).camera.focal[0], rel=0.01)


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("quarter", [1, 3])
def test_a_phone_turned_on_its_side_in_mid_walk_is_followed(
    demo_route: DemoRoute, frames: list[VideoFrame], known: bool, quarter: int
) -> None:
    """Its pictures turn with it: from wide to tall and back."""
    session = NavigationSession(demo_route.route_map, demo_route.follower.camera if known else None)
    # Where the upright picture's axes lie in the turned one.
    turn = np.linalg.matrix_power(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), quarter)
    updates, answered = [], 0
    for k, frame in enumerate(frames[:90]):
        rolled = 30 <= k < 60
        image = np.ascontiguousarray(np.rot90(frame.image, -quarter)) if rolled else frame.image
        update = session.process(image, frame.time, k)
        assert update.fix is None or np.isfinite(update.fix.covariance).all()
        if rolled and update.fix is not None:
            answered += 1
            pose = update.fix.world_from_camera
            upright = SE3(pose.rotation @ turn, pose.translation)
            truth = demo_route.follower.truth
            found = demo_route.judgement.alignment.whole.rotation @ upright.rotation
            angle = np.degrees(np.arccos(np.clip((np.trace(found.T @ truth.rotation[k]) - 1) / 2, -1, 1)))
            assert angle < 3.0
        updates.append(update)
    assert answered >= 28
    whole = demo_route.judgement.alignment.whole
    errors = [
        np.linalg.norm(whole @ u.fix.world_from_camera.translation - demo_route.follower.truth.position[k])
        for k, u in enumerate(updates)
        if u.fix is not None
    ]
    assert len(errors) >= 86
    assert np.median(errors) < 0.08
    assert max(errors[10:]) < 0.3
    assert _learnt(session).camera.focal[0] == pytest.approx(540.0, rel=0.015)


def test_a_fisheye_that_was_described_is_found(demo_route: DemoRoute) -> None:
    lens = LensCamera("OPENCV_FISHEYE", 640, 480, (330.0, 330.0, 320.0, 240.0, 0.02, -0.01, 0.0, 0.0))
    world = build_world("synthetic", CORRIDOR_AND_ROOM, np.random.default_rng([7, 0]))
    renderer = Renderer(world, lens)
    session = NavigationSession(demo_route.route_map, Camera.from_json(lens.to_json(10.0)))
    truth, whole = demo_route.follower.truth, demo_route.judgement.alignment.whole
    errors = []
    rows = range(0, 150, 15)
    for k in rows:
        pose = Pose(truth.rotation[k], truth.position[k])
        picture = renderer.render(pose, Light(), np.random.default_rng(k))
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY))
        fix = session.process(grey, truth.time[k], k).fix
        if fix is not None:
            errors.append(float(np.linalg.norm(whole @ fix.world_from_camera.translation - pose.position)))
    assert len(errors) >= 0.8 * len(rows)
    assert np.median(errors) < 0.06
    assert max(errors) < 0.3
