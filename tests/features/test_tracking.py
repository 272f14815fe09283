"""Tracks through known motions of the image."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from server.features.extraction import OrbExtractor, OrbOptions
from server.features.tracking import FeatureTracker, TrackedFeatures, TrackerOptions

Image = NDArray[np.uint8]
HEIGHT, WIDTH = 360, 480
MARGIN = 80


def _texture(seed: int) -> NDArray[np.float32]:
    """A larger picture than is seen, detailed at several scales."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN), np.float32)
    for sigma, weight in ((1.2, 50.0), (3.0, 40.0), (8.0, 30.0)):
        noise = cv2.GaussianBlur(rng.normal(size=picture.shape).astype(np.float32), (0, 0), sigma)
        picture += weight * noise / noise.std()
    return np.clip(128 + picture, 0, 255)


def _motion(degrees: float, zoom: float, shift: tuple[float, float], tilt: float = 0.0) -> np.ndarray:
    """Homography (3, 3) about the image's centre, in pixels whose first centre is (0.5, 0.5)."""
    c, s = zoom * np.cos(np.deg2rad(degrees)), zoom * np.sin(np.deg2rad(degrees))
    about = np.array([[1, 0, -WIDTH / 2], [0, 1, -HEIGHT / 2], [0, 0, 1.0]])
    move = np.array([[c, -s, shift[0]], [s, c, shift[1]], [tilt, 0, 1.0]])
    return np.asarray(np.linalg.inv(about) @ move @ about)


def _moved(motion: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    out = np.column_stack([pixels, np.ones(len(pixels))]) @ motion.T
    return np.asarray(out[:, :2] / out[:, 2:])


def _view(texture: NDArray[np.float32], motion: np.ndarray) -> Image:
    """The picture after the motion, by splines: OpenCV's warp rounds to a thirty-second of a pixel."""
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x, y = _moved(np.linalg.inv(motion), np.column_stack([u.ravel(), v.ravel()])).T + MARGIN - 0.5
    picture = map_coordinates(texture, [y, x], order=3).reshape(HEIGHT, WIDTH)
    return np.clip(picture, 0, 255).round().astype(np.uint8)


def _tracker(count: int = 500) -> FeatureTracker:
    return FeatureTracker(OrbExtractor(OrbOptions(count=count)), TrackerOptions(count=count))


def _common(a: TrackedFeatures, b: TrackedFeatures) -> tuple[np.ndarray, np.ndarray]:
    _, i, j = np.intersect1d(a.track, b.track, assume_unique=True, return_indices=True)
    return a.features.pixels[i], b.features.pixels[j]


@pytest.mark.parametrize(
    "motion",
    [
        _motion(0.0, 1.0, (5.3, -3.7)),
        _motion(2.5, 1.0, (2.0, 1.0)),
        _motion(0.0, 1.04, (0.0, 0.0)),
        _motion(-1.0, 0.97, (12.0, 4.0), tilt=1e-4),
    ],
    ids=["shift", "turn", "zoom", "all"],
)
def test_tracks_follow_the_image_to_a_fifth_of_a_pixel(motion: np.ndarray) -> None:
    texture = _texture(1)
    tracker = _tracker()
    first = tracker.follow(_view(texture, np.eye(3)))
    second = tracker.follow(_view(texture, motion))
    before, after = _common(first, second)
    assert len(before) > 0.8 * len(first)
    offset = after - _moved(motion, before)
    error = np.linalg.norm(offset, axis=1)
    assert np.median(error) < 0.06
    assert np.percentile(error, 95) < 0.2
    assert np.abs(offset.mean(axis=0)).max() < 0.015


def test_a_prediction_bridges_a_leap() -> None:
    """A leap further than the pyramid reaches is followed when told, and never taken for another."""
    texture = _texture(2)
    motion = _motion(0.0, 1.0, (70.0, 20.0))
    told, alone = _tracker(), _tracker()
    first = told.follow(_view(texture, np.eye(3)))
    alone.follow(_view(texture, np.eye(3)))
    jump = _view(texture, motion)
    expected = first.features.pixels + np.array([66.0, 22.0])
    before, after = _common(first, told.follow(jump, predicted=expected))
    assert len(before) > 0.6 * len(first)
    assert np.percentile(np.linalg.norm(after - _moved(motion, before), axis=1), 95) < 0.2
    found_alone = _common(first, alone.follow(jump))[0]
    assert len(found_alone) < len(before)


def test_tracks_live_long_are_unique_and_never_come_back() -> None:
    texture = _texture(3)
    tracker = _tracker(300)
    born: dict[int, int] = {}
    dead: set[int] = set()
    alive: set[int] = set()
    frames = [tracker.follow(_view(texture, _motion(0.3 * k, 1.0, (2.5 * k, 1.0 * k)))) for k in range(20)]
    for k, frame in enumerate(frames):
        track = frame.track.tolist()
        assert len(set(track)) == len(track) == len(frame.features) == len(frame)
        assert len(frame) <= 300
        fresh = set(track) - alive
        assert not fresh & dead
        # New ones are numbered on, in the order of birth.
        assert not fresh or min(fresh) > max(born, default=-1)
        for identity in fresh:
            born[identity] = k
        dead |= alive - set(track)
        alive = set(track)
        np.testing.assert_array_equal(frame.age, [k - born[identity] for identity in track])
    assert (frames[-1].age == 19).sum() > 60
    # Nineteen frames on, the oldest are still where the image has carried them.
    before, after = _common(frames[0], frames[-1])
    error = np.linalg.norm(after - _moved(_motion(0.3 * 19, 1.0, (47.5, 19.0)), before), axis=1)
    assert np.median(error) < 0.3


def test_new_tracks_keep_their_distance() -> None:
    texture = _texture(4)
    tracker = FeatureTracker(OrbExtractor(OrbOptions(count=600)), TrackerOptions(count=2000))
    tracker.follow(_view(texture, np.eye(3)))
    second = tracker.follow(_view(texture, _motion(0.0, 1.0, (40.0, 0.0))))
    new = second.features.pixels[second.age == 0]
    old = second.features.pixels[second.age > 0]
    assert len(new) > 20
    assert np.linalg.norm(new[:, None] - old, axis=2).min() > tracker.options.spacing


def test_no_track_enters_a_mask() -> None:
    texture = _texture(5)
    tracker = _tracker()
    tracker.follow(_view(texture, np.eye(3)))
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[100:250, 150:350] = True
    second = tracker.follow(_view(texture, _motion(0.0, 1.0, (4.0, 0.0))), mask=mask)
    followed = second.features.pixels[second.age > 0]
    assert len(followed) > 150
    columns, rows = followed.astype(int).T
    assert not mask[rows, columns].any()


def test_most_tracks_end_where_the_picture_changes() -> None:
    """Another picture altogether: what little agrees by chance in both directions is left to the pose."""
    tracker = _tracker()
    first = tracker.follow(_view(_texture(6), np.eye(3)))
    second = tracker.follow(_view(_texture(7), np.eye(3)))
    assert len(_common(first, second)[0]) < 0.3 * len(first)


def test_a_dark_frame_ends_all_tracks_and_light_begins_new_ones() -> None:
    texture = _texture(8)
    tracker = _tracker()
    first = tracker.follow(_view(texture, np.eye(3)))
    dark = tracker.follow(np.zeros((HEIGHT, WIDTH), np.uint8))
    again = tracker.follow(_view(texture, np.eye(3)))
    assert len(dark) == 0
    assert len(again) > 300
    assert again.track.min() > first.track.max()


def test_followed_features_look_as_they_were_last_detected() -> None:
    """A descriptor of a track stays close to the first one, as the picture hardly changes."""
    texture = _texture(9)
    tracker = _tracker()
    first = tracker.follow(_view(texture, np.eye(3)))
    last = first
    for k in range(1, 6):
        last = tracker.follow(_view(texture, _motion(0.0, 1.0, (3.0 * k, 0.0))))
    _, i, j = np.intersect1d(first.track, last.track, assume_unique=True, return_indices=True)
    bits = np.unpackbits(first.features.descriptors[i] ^ last.features.descriptors[j], axis=1).sum(axis=1)
    assert len(i) > 200
    assert np.median(bits) < 30
    assert (np.abs(first.features.octaves[i].astype(int) - last.features.octaves[j]) <= 2).all()
