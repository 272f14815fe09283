"""A follower's session on a real map of the synthetic building: fixes, refusals, states, replay."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from demo_route import DemoRoute

from client_sim.synthetic.buildings import CORRIDOR_AND_ROOM, build_world
from client_sim.synthetic.cameras import PinholeCamera, Pose, level_rotation
from client_sim.synthetic.rendering import Light, Renderer
from client_sim.synthetic.small_walks import FOLLOWER_CAMERA
from server.evaluation.follower import AnsweredFrame, FollowerJudgement, judge_follower
from server.geometry.cameras import Camera
from server.mapping.codec import load_route_map
from server.mapping.video import VideoFrame, read_frames
from server.navigation.session import NavigationSession, SessionSnapshot
from server.navigation.updates import Instruction, NavigationState, RefusalReason, Update

BLIND = np.full((480, 640), 12, np.uint8)


@pytest.fixture(scope="module")
def frames(demo_route: DemoRoute) -> list[VideoFrame]:
    """The follower's pictures."""
    return list(read_frames(demo_route.follower.video))


def _run(session: NavigationSession, frames: Sequence[VideoFrame], first: int = 0) -> list[Update]:
    return [session.process(f.image, f.time, first + k) for k, f in enumerate(frames)]


@pytest.fixture(scope="module")
def updates(demo_route: DemoRoute, frames: list[VideoFrame]) -> list[Update]:
    """The answers to a whole walk."""
    return _run(NavigationSession(demo_route.route_map, demo_route.follower.camera), frames)


@pytest.fixture(scope="module")
def judgement(demo_route: DemoRoute, updates: list[Update]) -> FollowerJudgement:
    """The answers against the truth."""
    answers = [AnsweredFrame(k, update, 0.0) for k, update in enumerate(updates)]
    return judge_follower(demo_route.leader, demo_route.judgement, demo_route.follower, answers)


def _same(a: Update, b: Update) -> bool:
    """Whether two updates are the same, bit for bit."""
    if (a.fix is None) != (b.fix is None):
        return False
    if a.fix is not None and b.fix is not None:
        poses = [(u.world_from_camera.rotation, u.world_from_camera.translation) for u in (a.fix, b.fix)]
        if any(x.tobytes() != y.tobytes() for x, y in zip(*poses, strict=True)):
            return False
        if a.fix.covariance.tobytes() != b.fix.covariance.tobytes():
            return False
        if (a.fix.inliers, a.fix.matches, a.fix.keyframe, a.fix.strong) != (
            b.fix.inliers,
            b.fix.matches,
            b.fix.keyframe,
            b.fix.strong,
        ):
            return False
    return replace(a, fix=None) == replace(b, fix=None)


def test_nearly_every_frame_is_fixed_where_it_was_taken(judgement: FollowerJudgement) -> None:
    report = judgement.report
    assert report.relocalized_fraction >= 0.98
    assert report.false_fixes == 0
    assert report.position_error_m.median is not None
    assert report.position_error_m.median < 0.03
    assert report.position_error_m.max is not None
    assert report.position_error_m.max < 0.15
    assert report.rotation_error_deg.max is not None
    assert report.rotation_error_deg.max < 2.0


def test_the_hints_are_the_true_ones(judgement: FollowerJudgement) -> None:
    assert judgement.report.hint_agreement is not None
    assert judgement.report.hint_agreement >= 0.9
    assert judgement.report.arrived


def test_exactly_one_of_fix_and_refusal_is_set_and_frames_are_echoed(
    updates: list[Update], frames: list[VideoFrame]
) -> None:
    for k, (update, frame) in enumerate(zip(updates, frames, strict=True)):
        assert (update.fix is None) != (update.refusal is None)
        assert (update.sequence, update.capture_time) == (k, frame.time)


def test_fixes_are_as_sure_as_they_say(
    demo_route: DemoRoute, judgement: FollowerJudgement, updates: list[Update]
) -> None:
    """Errors in units of the covariance: neither far beyond it nor a fraction of it."""
    scale = demo_route.judgement.alignment.whole.scale
    ratios = []
    for update, error in zip(updates, judgement.position_error_m, strict=True):
        if update.fix is not None:
            sigma = scale * np.sqrt(np.trace(update.fix.covariance[3:, 3:]))
            ratios.append(error / sigma)
            np.testing.assert_allclose(update.fix.covariance, update.fix.covariance.T, rtol=1e-6, atol=1e-15)
            assert np.linalg.eigvalsh(update.fix.covariance).min() > 0
    assert 0.3 < np.median(ratios) < 3.0


def test_a_walk_ends_in_arrival_and_not_before_its_end(demo_route: DemoRoute, updates: list[Update]) -> None:
    states = [update.state for update in updates]
    first = states.index(NavigationState.ARRIVED)
    assert first > 0.85 * len(states)
    assert set(states[:first]) == {NavigationState.ON_ROUTE}
    assert set(states[first:]) == {NavigationState.ARRIVED}
    last = updates[-1].guidance
    assert last is not None
    assert last.instruction is Instruction.ARRIVED
    assert last.progress > 0.94
    progress = np.array([u.guidance.progress for u in updates if u.guidance is not None])
    assert np.diff(progress).min() > -0.02


def test_both_turns_are_announced(updates: list[Update]) -> None:
    turns = [u.guidance.next_turn for u in updates if u.guidance is not None]
    signs = [0 if t is None else int(np.sign(t.angle)) for t in turns]
    assert [s for k, s in enumerate(signs) if k == 0 or signs[k - 1] != s] == [1, -1, 0]
    assert turns[0] is not None
    # 6.2 m of corridor at the leader's 1.1 m a second.
    assert 3.5 < turns[0].seconds < 6.0
    assert all(t is None or t.distance_m is None for t in turns)


def test_the_same_frames_give_the_same_updates(
    demo_route: DemoRoute, frames: list[VideoFrame], updates: list[Update]
) -> None:
    again = _run(NavigationSession(demo_route.route_map, demo_route.follower.camera), frames[:40])
    assert all(_same(a, b) for a, b in zip(again, updates, strict=False))


def test_a_session_goes_on_elsewhere_as_if_nothing_had_happened(
    demo_route: DemoRoute, frames: list[VideoFrame], updates: list[Update]
) -> None:
    camera = demo_route.follower.camera
    session = NavigationSession(demo_route.route_map, camera)
    _run(session, frames[:30])
    taken = SessionSnapshot.from_json(json.loads(json.dumps(session.snapshot().to_json())))
    assert taken == session.snapshot()
    resumed = NavigationSession(load_route_map(demo_route.map_file), camera, snapshot=taken)
    for update, expected in zip(_run(resumed, frames[30:60], 30), updates[30:60], strict=True):
        assert _same(update, expected)


def test_a_refused_frame_right_after_a_resume_is_no_shock(
    demo_route: DemoRoute, frames: list[VideoFrame]
) -> None:
    """What is not in the snapshot is the last guidance: it comes with the next fix."""
    camera = demo_route.follower.camera
    session = NavigationSession(demo_route.route_map, camera)
    _run(session, frames[:3])
    resumed = NavigationSession(demo_route.route_map, camera, snapshot=session.snapshot())
    update = resumed.process(BLIND, 0.3, 3)
    assert update.state is NavigationState.ON_ROUTE
    assert update.refusal is not None
    assert resumed.process(frames[4].image, 0.4, 4).guidance is not None


def _searching(demo_route: DemoRoute) -> NavigationSession:
    return NavigationSession(demo_route.route_map, demo_route.follower.camera)


def _noise(kind: str, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    if kind == "white noise":
        return rng.integers(0, 256, (480, 640), np.uint8)
    if kind == "coarse noise":
        return np.asarray(
            cv2.resize(rng.integers(0, 256, (60, 80), np.uint8), (640, 480), interpolation=cv2.INTER_CUBIC)
        )
    if kind == "chessboard":
        return np.asarray(255 * (np.indices((480, 640)) // 20).sum(axis=0) % 2, dtype=np.uint8) * 200
    if kind == "blurred":
        return np.asarray(cv2.GaussianBlur(rng.integers(0, 256, (480, 640), np.uint8), (0, 0), 25))
    return np.full((480, 640), {"black": 0, "grey": 128, "white": 255}[kind], np.uint8)


@pytest.mark.parametrize(
    "kind", ["black", "grey", "white", "white noise", "coarse noise", "chessboard", "blurred"]
)
def test_a_picture_of_nothing_is_refused_with_a_reason(demo_route: DemoRoute, kind: str) -> None:
    session = _searching(demo_route)
    for k in range(3):
        update = session.process(_noise(kind, k), 0.1 * k, k)
        assert update.fix is None
        assert update.refusal is not None
        assert update.state is NavigationState.SEARCHING
        assert update.guidance is None
        if kind in ("black", "grey", "white", "blurred"):
            assert update.refusal.reason is RefusalReason.TOO_FEW_FEATURES


def test_a_picture_of_nothing_is_refused_on_the_route_too(
    demo_route: DemoRoute, frames: list[VideoFrame]
) -> None:
    """A prior must not turn chance matches into a fix."""
    session = _searching(demo_route)
    _run(session, frames[:5])
    for k, kind in enumerate(["white noise", "coarse noise", "chessboard", "black"]):
        update = session.process(_noise(kind), 0.5 + 0.1 * k, 5 + k)
        assert update.fix is None, kind


def test_another_building_is_refused_in_every_frame(demo_route: DemoRoute) -> None:
    """The same floor plan, hung with other pictures: doors, tiles and panels are of the same make."""
    world = build_world("elsewhere", CORRIDOR_AND_ROOM, np.random.default_rng(1234))
    renderer = Renderer(world, FOLLOWER_CAMERA)
    rng = np.random.default_rng(5)
    session = _searching(demo_route)
    poses = [Pose(p.rotation, p.position) for p in _poses(demo_route, every=4)]
    for k, pose in enumerate(poses):
        picture = cv2.cvtColor(renderer.render(pose, Light(), rng), cv2.COLOR_BGR2GRAY)
        update = session.process(np.asarray(picture), 0.1 * k, k)
        assert update.fix is None, f"frame {k}: {update.fix}"
        assert update.state is NavigationState.SEARCHING


def _poses(demo_route: DemoRoute, every: int) -> list[Pose]:
    truth = demo_route.follower.truth
    return [Pose(truth.rotation[k], truth.position[k]) for k in range(0, len(truth), every)]


def test_a_view_the_leader_never_had_is_refused_or_right(demo_route: DemoRoute) -> None:
    """Looking back along the corridor: few landmarks, seen from behind at best."""
    world = build_world("synthetic", CORRIDOR_AND_ROOM, np.random.default_rng([7, 0]))
    renderer = Renderer(world, FOLLOWER_CAMERA)
    session = _searching(demo_route)
    whole = demo_route.judgement.alignment.whole
    fixes = 0
    for k, x in enumerate(np.arange(2.0, 6.0, 0.4)):
        position = np.array([x, 1.0, 1.6])
        picture = cv2.cvtColor(renderer.render(Pose(level_rotation(np.pi), position)), cv2.COLOR_BGR2GRAY)
        update = session.process(np.asarray(picture), 5.0 * k, k)
        if update.fix is not None:
            fixes += 1
            assert np.linalg.norm(whole @ update.fix.world_from_camera.translation - position) < 0.3
    assert fixes <= 5


def test_states_follow_what_is_seen(demo_route: DemoRoute, frames: list[VideoFrame]) -> None:
    session = _searching(demo_route)
    told: list[tuple[NavigationState, bool]] = []

    def show(image: np.ndarray, time: float) -> None:
        update = session.process(image, time, len(told))
        told.append((update.state, update.guidance is not None))

    for k in range(3):
        show(BLIND, 0.1 * k)
    assert told == [(NavigationState.SEARCHING, False)] * 3
    for k in range(3, 8):
        show(frames[k].image, 0.1 * k)
    assert told[3:] == [(NavigationState.ON_ROUTE, True)] * 5
    # Guidance holds 0.75 s, the state 3 s without a fix.
    for k in range(8, 45):
        show(BLIND, 0.1 * k)
    states, guided = zip(*told[8:], strict=True)
    without = 0.1 * np.arange(8, 45) - 0.7
    np.testing.assert_array_equal([s is NavigationState.LOST for s in states], without > 3.0 + 1e-9)
    np.testing.assert_array_equal(guided, without <= 0.75)
    show(frames[45].image, 4.5)
    assert told[-1] == (NavigationState.ON_ROUTE, True)


def test_who_has_arrived_is_not_lost_with_the_phone_in_the_pocket(
    demo_route: DemoRoute, frames: list[VideoFrame]
) -> None:
    session = _searching(demo_route)
    assert session.process(frames[-1].image, 0.0, 0).state is NavigationState.ARRIVED
    assert session.process(BLIND, 60.0, 1).state is NavigationState.ARRIVED


def test_frames_out_of_order_are_answered_without_a_crash(
    demo_route: DemoRoute, frames: list[VideoFrame], updates: list[Update]
) -> None:
    session = _searching(demo_route)
    order = [0, 1, 4, 2, 3, 3, 9, 5, 0, 10]
    for k, index in enumerate(order):
        update = session.process(frames[index].image, frames[index].time, k)
        assert update.fix is not None, index
        truth = updates[index].fix
        assert truth is not None
        offset = update.fix.world_from_camera.translation - truth.world_from_camera.translation
        assert np.linalg.norm(offset) < 0.05
        assert update.guidance is not None


@pytest.mark.parametrize("jump", [-1e9, -100.0, 1e9])
def test_a_phone_whose_clock_jumps_is_found_again(
    demo_route: DemoRoute, frames: list[VideoFrame], jump: float
) -> None:
    session = _searching(demo_route)
    _run(session, frames[:3])
    update = session.process(frames[60].image, jump, 3)
    assert update.fix is not None
    for k in range(10):
        update = session.process(frames[60 + k].image, jump + 0.1 * k, 4 + k)
    assert update.guidance is not None
    assert update.guidance.progress == pytest.approx(69 / len(frames), abs=0.1)


def test_a_hint_does_not_outlive_a_clock_that_was_set_back(
    demo_route: DemoRoute, frames: list[VideoFrame]
) -> None:
    """As a page's clock is when it is loaded anew: what was true before may be long ago."""
    session = NavigationSession(demo_route.route_map, demo_route.follower.camera)
    for k, frame in enumerate(frames[:5]):
        before = session.process(frame.image, 600.0 + frame.time, k)
    assert before.state is NavigationState.ON_ROUTE
    assert before.guidance is not None
    after = session.process(BLIND, 2.0, 5)
    assert (after.state, after.guidance) == (NavigationState.LOST, None)


def test_a_follower_who_starts_in_the_middle_is_found_there(
    demo_route: DemoRoute, frames: list[VideoFrame]
) -> None:
    update = _searching(demo_route).process(frames[75].image, 0.0, 0)
    assert update.guidance is not None
    assert update.guidance.progress == pytest.approx(75 / len(frames), abs=0.08)


@pytest.mark.parametrize("size", [(1280, 960), (480, 360), (320, 240)])
def test_a_frame_of_another_size_is_the_same_view(
    demo_route: DemoRoute, frames: list[VideoFrame], updates: list[Update], size: tuple[int, int]
) -> None:
    session = _searching(demo_route)
    fixes = 0
    for k in range(0, 100, 10):
        update = session.process(np.asarray(cv2.resize(frames[k].image, size)), frames[k].time, k)
        same = updates[k].fix
        if update.fix is not None and same is not None:
            fixes += 1
            offset = update.fix.world_from_camera.translation - same.world_from_camera.translation
            assert np.linalg.norm(offset) < (0.06 if size[0] > 400 else 0.15)
    assert fixes >= (9 if size[0] > 400 else 5)


def test_frames_may_change_size_within_a_session(demo_route: DemoRoute, frames: list[VideoFrame]) -> None:
    session = _searching(demo_route)
    for k, size in enumerate([(640, 480), (480, 360), (640, 480)]):
        update = session.process(np.asarray(cv2.resize(frames[k].image, size)), 0.1 * k, k)
        assert update.fix is not None, size


def test_a_frame_of_another_shape_is_an_error(demo_route: DemoRoute) -> None:
    session = _searching(demo_route)
    with pytest.raises(ValueError, match="640x360"):
        session.process(np.zeros((360, 640), np.uint8), 0.0, 0)
    assert session.process(BLIND, 0.1, 1).refusal is not None


def test_a_phone_held_sideways_is_the_same_with_its_own_camera(demo_route: DemoRoute) -> None:
    """An upright picture, taller than wide, from the same place: the pose does not care."""
    world = build_world("synthetic", CORRIDOR_AND_ROOM, np.random.default_rng([7, 0]))
    tall = PinholeCamera(480, 640, 540.0, 540.0, 240.0, 320.0)
    renderer = Renderer(world, tall)
    camera = Camera.pinhole(480, 640, 540.0, 540.0, 240.0, 320.0)
    session = NavigationSession(demo_route.route_map, camera)
    whole = demo_route.judgement.alignment.whole
    errors = []
    for k, pose in enumerate(_poses(demo_route, every=10)):
        picture = cv2.cvtColor(renderer.render(pose, Light(), np.random.default_rng(k)), cv2.COLOR_BGR2GRAY)
        fix = session.process(np.asarray(picture), 1.0 * k, k).fix
        if fix is not None:
            errors.append(np.linalg.norm(whole @ fix.world_from_camera.translation - pose.position))
    assert len(errors) >= 12
    assert max(errors) < 0.25


def test_wrong_intrinsics_are_refused_or_nearly_right(
    demo_route: DemoRoute, frames: list[VideoFrame], updates: list[Update]
) -> None:
    """A phone of unknown camera guesses its focal length a tenth too long: never a place far off."""
    camera = demo_route.follower.camera
    fx, fy, cx, cy = camera.params
    session = NavigationSession(
        demo_route.route_map, Camera.pinhole(camera.width, camera.height, 1.1 * fx, 1.1 * fy, cx, cy)
    )
    for k in range(0, len(frames), 7):
        fix, true = session.process(frames[k].image, frames[k].time, k).fix, updates[k].fix
        if fix is not None and true is not None:
            offset = fix.world_from_camera.translation - true.world_from_camera.translation
            assert np.linalg.norm(offset) < 1.0
