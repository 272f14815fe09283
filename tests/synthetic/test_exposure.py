"""Automatic exposure, and the blur of an open shutter."""

from __future__ import annotations

import time

import numpy as np
import pytest

from client_sim.synthetic.cameras import LensCamera, PinholeCamera, Pose, level_rotation
from client_sim.synthetic.exposure import (
    REFERENCE_S,
    AutoExposure,
    AutoExposureOptions,
    ExposureSettings,
    Light,
)
from client_sim.synthetic.people import Passerby, crowd_at
from client_sim.synthetic.rendering import Renderer
from client_sim.synthetic.venue import Building
from client_sim.synthetic.worlds import World, wall

CAMERA = PinholeCamera(320, 240, 250.0, 250.0, 160.0, 120.0)


def _settle(exposure: AutoExposure, scene: float, frames: int) -> list[float]:
    """Grey levels of a scene that has ``scene`` at the reference exposure, at 10 frames a second."""
    levels = []
    for _ in range(frames):
        levels.append(min(255.0, scene * exposure.settings.factor))
        exposure.measure(levels[-1], 0.1)
    return levels


def test_exposure_reaches_its_target_and_keeps_its_limits() -> None:
    options = AutoExposureOptions()
    for scene in (40.0, 90.0, 300.0):
        assert _settle(AutoExposure(options), scene, 60)[-1] == pytest.approx(options.target, rel=0.02)
    dark, bright = AutoExposure(options), AutoExposure(options)
    _settle(dark, 1.0, 100)
    assert dark.settings.time_s == pytest.approx(options.longest_s)
    assert dark.settings.gain == pytest.approx(options.greatest_gain)
    _settle(bright, 1e5, 100)
    assert bright.settings.time_s == pytest.approx(options.shortest_s)
    assert bright.settings.gain == 1.0


def test_exposure_is_late_by_its_latency_and_then_gradual() -> None:
    options = AutoExposureOptions(latency=3)
    levels = np.array(_settle(AutoExposure(options), 40.0, 40))
    assert (levels[:3] == levels[0]).all()
    assert levels[3] > levels[0]
    assert levels[3] < 0.6 * options.target
    assert (np.diff(levels[3:25]) > -1e-9).all() or levels.max() < 1.25 * options.target


def test_more_light_on_the_sensor_is_a_brighter_picture(office: Building) -> None:
    renderer = Renderer(office.world, CAMERA)
    pose = Pose(level_rotation(0.0), np.array([8.0, 2.7, 1.5]))
    plain = renderer.shoot([pose]).image.astype(float)
    half = renderer.shoot([pose], exposure=ExposureSettings(REFERENCE_S / 2)).image.astype(float)
    unclipped = plain < 250
    assert (half[unclipped] / np.maximum(plain[unclipped], 1)).mean() == pytest.approx(0.5, abs=0.01)
    noise = [
        renderer.shoot(
            [pose],
            Light(noise=2.0, vignette=0.0),
            np.random.default_rng(1),
            (),
            ExposureSettings(REFERENCE_S / gain, gain),
        ).image.astype(float)
        - renderer.shoot(
            [pose], Light(noise=0.0, vignette=0.0), None, (), ExposureSettings(REFERENCE_S / gain, gain)
        ).image
        for gain in (1.0, 4.0)
    ]
    inside = (plain > 30).all(axis=2) & (plain < 220).all(axis=2)
    assert noise[1][inside].std() / noise[0][inside].std() == pytest.approx(2.0, rel=0.05)


def _swept(angle: float, count: int) -> list[Pose]:
    """A camera that turns and goes ahead a little while the shutter is open."""
    return [
        Pose(level_rotation(0.2 + angle * part, -0.05), np.array([8.0 + 0.02 * part, 2.6, 1.5]))
        for part in np.linspace(-0.5, 0.5, count)
    ]


def test_blur_is_the_mean_of_the_sharp_pictures(office: Building) -> None:
    renderer = Renderer(office.world, CAMERA)
    poses = _swept(0.03, 41)
    truth = np.mean([renderer.render(pose).astype(float) for pose in poses], axis=0)
    blurred = renderer.shoot([poses[0], poses[20], poses[-1]]).image.astype(float)
    sharp = renderer.render(poses[20]).astype(float)
    inner = (slice(10, -10), slice(12, -12))
    assert np.abs(blurred - truth)[inner].mean() < 0.25 * np.abs(sharp - truth)[inner].mean()
    still = renderer.shoot([poses[20]] * 3).image
    np.testing.assert_array_equal(still, renderer.render(poses[20]))


def test_an_edge_is_blurred_over_the_way_it_moves() -> None:
    black, white = (np.full((8, 8, 3), level, np.uint8) for level in (0, 255))
    world = World(
        "edge", (wall((4.0, -4.0), (4.0, 0.0), 0, 3, black), wall((4.0, 0.0), (4.0, 4.0), 0, 3, white))
    )
    angle = 0.04
    poses = [Pose(level_rotation(a), np.array([0.0, 0.0, 1.5])) for a in (-angle / 2, 0.0, angle / 2)]
    row = Renderer(world, CAMERA).shoot(poses).image[120, :, 1].astype(float)
    width = ((row > 25) & (row < 230)).sum() / 0.8
    assert width == pytest.approx(angle * 250.0, abs=2.0)


@pytest.mark.parametrize(
    "camera",
    [PinholeCamera(), LensCamera("OPENCV", 640, 480, (500.0, 500.0, 320.0, 240.0, 0.1, -0.1, 0.0, 0.0))],
)
def test_a_second_of_video_takes_less_than_a_second(office: Building, camera: PinholeCamera) -> None:
    """Ten frames with people, a mirror, blur, light and noise, in processor time."""
    renderer = Renderer(office.world, camera)
    people = [Passerby(((18.4, 4.0, 0.0), (18.4, 16.0, 0.0)), look=k, start_s=-2.0 * k) for k in range(3)]
    rng = np.random.default_rng(1)
    spent = []
    for frame in range(11):
        poses = [
            Pose(level_rotation(1.2 + 0.02 * part), np.array([18.9, 6.0 + 0.1 * frame, 1.5]))
            for part in (-0.5, 0.0, 0.5)
        ]
        started = time.thread_time()
        shot = renderer.shoot(poses, Light(), rng, crowd_at(people, 0.1 * frame))
        spent.append(time.thread_time() - started)
        assert shot.mirror.any()
        assert shot.mask("person").any()
    assert np.median(spent[1:]) < 0.1
