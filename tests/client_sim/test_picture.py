"""What is drawn of a replay: where the tracks lie in a plan, and which of the pictures are shown."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from client_sim.filmstrip import caption, longest_refusal, telling_pictures
from client_sim.outcome import FrameRecord
from client_sim.picture import place_tracks
from client_sim.plan import FloorPlan, similarity
from server.protocol.documents import PathDocument, TurnDocument
from server.protocol.messages import (
    Age,
    FixMessage,
    FrameCounts,
    GuidanceMessage,
    RefusalMessage,
    UpdateMessage,
)

COUNTS = FrameCounts(received=0, answered=0, replaced=0, stale=0, bad=0)


def _record(
    number: int,
    instruction: str | None = "straight",
    refused: str | None = None,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> FrameRecord:
    guidance = None
    if instruction is not None:
        guidance = GuidanceMessage(
            progress=number / 100,
            walked_m=None,
            remaining_m=None,
            remaining_s=5.0,
            instruction=instruction,
            bearing=0.0,
            next_turn=None,
        )
    fix = FixMessage(
        position=position,
        orientation=(0.0, 0.0, 0.0, 1.0),
        position_sigma=0.1,
        rotation_sigma=0.1,
        inliers=40,
        matches=60,
        keyframe=1,
    )
    update = UpdateMessage(
        sequence=number,
        capture_time_us=0,
        age=Age(server_ms=1, capture_ms=None),
        state="on_route",
        fix=None if refused else fix,
        refusal=RefusalMessage(reason=refused, inliers=0) if refused else None,
        guidance=guidance,
        frames=COUNTS,
    )
    return FrameRecord(number, number, number / 10, number / 10, update=update)


def _story(*parts: tuple[int, str | None, str | None]) -> list[FrameRecord]:
    """So many pictures with an instruction, or refused with a reason, one part after another."""
    flat = [(instruction, refused) for count, instruction, refused in parts for _ in range(count)]
    return [_record(number, instruction, refused) for number, (instruction, refused) in enumerate(flat)]


def _numbers(records: Sequence[FrameRecord]) -> list[int]:
    return [record.sequence for record in records]


def test_the_pictures_shown_tell_the_story_in_its_order() -> None:
    story = _story(
        (20, "straight", None),
        (5, "left", None),
        (10, "straight", None),
        (20, None, "too_few_features"),
        (10, "straight", None),
        (5, "right", None),
        (30, "straight", None),
    )
    assert _numbers(telling_pictures(story)) == [5, 22, 45, 67, 99]
    assert _numbers(telling_pictures(story, most=3)) == [5, 45, 99]
    assert len(telling_pictures(_story((60, "straight", None)))) == 5
    assert telling_pictures(_story((9, None, "ambiguous")))


def test_refusals_before_the_first_fix_are_a_search_and_no_darkness() -> None:
    searching, found = (30, None, "no_similar_place"), (5, "straight", None)
    assert longest_refusal(_story(searching, found)) == []
    story = _story(searching, found, (2, None, "ambiguous"), found)
    assert longest_refusal(story) == []
    story = _story(searching, found, (4, None, "ambiguous"), found, (7, None, "ambiguous"), found)
    assert _numbers(longest_refusal(story)) == list(range(44, 51))


def test_a_refused_picture_says_why() -> None:
    refused = _record(1, None, "too_few_features").update
    assert refused is not None
    assert caption(refused) == "Nothing to see: hold the phone up, pointing forward."
    held = _record(1, "left", "too_few_features").update
    assert held is not None
    assert caption(held) == "Turn left.", "guidance holds for a moment without a fix"


def test_a_similarity_is_found_exactly_and_with_noise_by_the_least_squares() -> None:
    rng = np.random.default_rng(2)
    source = rng.normal(size=(40, 3))
    rotation, shift = Rotation.random(rng=rng).as_matrix(), np.array([3.0, -2.0, 1.0])
    target = 2.5 * source @ rotation.T + shift
    found = similarity(source, target)
    assert found.scale == pytest.approx(2.5)
    np.testing.assert_allclose(found(source), target, atol=1e-9)
    noisy = target + rng.normal(scale=0.05, size=target.shape)
    best = similarity(source, noisy)
    error = ((best(source) - noisy) ** 2).sum()
    for change in (0.99, 1.01):
        worse = change * best.scale * (source - source.mean(axis=0)) @ best.rotation.T + noisy.mean(axis=0)
        assert ((worse - noisy) ** 2).sum() > error


def test_tracks_lie_in_the_plan_where_the_leader_truly_walked() -> None:
    times = np.linspace(0.0, 10.0, 50)
    true = np.stack([np.minimum(times, 5.0), np.maximum(times - 5.0, 0.0), 0.02 * np.sin(times)], axis=1)
    turned = Rotation.from_euler("z", 0.7).as_matrix()
    mapped = (true - true[0]) @ turned.T / 1.7
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(mapped, axis=0), axis=1))])
    path = PathDocument(
        metres_per_unit=None,
        scale_source="unknown",
        time_s=tuple(times),
        position=tuple(map(tuple, mapped)),
        arc_length=tuple(arc),
        tracked=(True,) * 50,
        turns=(TurnDocument(start=4.8 / 1.7, end=5.2 / 1.7, angle=1.5),),
    )
    plan = FloorPlan(np.array([[0.0, -1.0, 6.0, -1.0]]), times, true)
    fix = tuple(float(v) for v in mapped[10])
    drawn = place_tracks(path, [_record(0, position=fix), _record(1, None, "ambiguous")], plan)  # type: ignore[arg-type]
    np.testing.assert_allclose(drawn.leader, true[:, :2], atol=1e-6)
    np.testing.assert_allclose(drawn.follower[0], true[10, :2], atol=1e-6)
    assert np.isnan(drawn.follower[1]).all()
    ((place, angle),) = drawn.turns
    np.testing.assert_allclose(place, [5.0, 0.0], atol=0.15)
    assert angle == 1.5
    assert drawn.unit == "m"
    bare = place_tracks(path, [], None)
    assert bare.unit != "m"
    assert np.ptp(bare.leader, axis=0).max() == pytest.approx(np.linalg.norm(mapped[-1]), rel=0.2)
