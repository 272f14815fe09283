from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from recorded_video import write_video, write_walk

from client_sim.errors import WalkError
from client_sim.walk import Walk, encode_jpeg


@pytest.mark.parametrize(
    ("fps", "expected"),
    [(10, [0, 1, 2, 3, 4, 5, 6, 7, 8]), (30, [0, 3, 6, 9, 12]), (25, [0, 3, 5, 8, 10]), (5, [0, 1, 2, 3])],
)
def test_pictures_are_sampled_ten_a_second_by_their_timestamps(
    tmp_path: Path, fps: int, expected: list[int]
) -> None:
    walk = Walk.from_folder(write_walk(tmp_path / "walk", frames=expected[-1] + 1, fps=fps))
    frames = list(walk.frames())
    assert [frame.index for frame in frames] == expected
    assert [frame.time for frame in frames] == pytest.approx([i / fps for i in expected], abs=1e-3)


def test_a_sampled_picture_is_the_one_at_its_index(tmp_path: Path) -> None:
    walk = Walk.from_folder(write_walk(tmp_path / "walk", frames=10, fps=30))
    # Each frame is a flat grey of 20 times its index.
    levels = [float(frame.image.mean()) / 20 for frame in walk.frames()]
    assert levels == pytest.approx([0, 3, 6, 9], abs=0.3)


def test_what_is_no_walk_says_what_is_wrong(tmp_path: Path) -> None:
    with pytest.raises(WalkError, match="no such folder"):
        Walk.from_folder(tmp_path / "nothing")
    folder = write_walk(tmp_path / "walk", frames=3, fps=10)
    (folder / "camera.json").write_text('{"model": "PINHOLE", "width": 64}')
    with pytest.raises(WalkError, match=r"camera\.json: height"):
        Walk.from_folder(folder)


def test_a_video_that_is_none_or_of_another_camera_is_refused(tmp_path: Path) -> None:
    folder = write_walk(tmp_path / "walk", frames=3, fps=10)
    (folder / "video.mp4").write_bytes(b"not a video")
    with pytest.raises(WalkError, match="no video"):
        list(Walk.from_folder(folder).frames())
    write_video(folder / "video.mp4", frames=3, fps=10, size=(128, 96))
    with pytest.raises(WalkError, match="shows 128x96"):
        list(Walk.from_folder(folder).frames())


def test_a_video_may_be_of_an_unknown_camera(tmp_path: Path) -> None:
    folder = write_walk(tmp_path / "walk", frames=3, fps=10)
    walk = Walk.from_files(folder / "video.mp4", None)
    assert (walk.camera, walk.name) == (None, "video")
    assert [frame.image.shape for frame in walk.frames()] == [(48, 64, 3)] * 3
    (folder / "camera.json").unlink()
    whole = Walk.from_folder(folder)
    assert (whole.camera, whole.name, len(list(whole.frames()))) == (None, "walk", 3)


def test_sensor_readings_are_read_in_order(tmp_path: Path) -> None:
    folder = write_walk(tmp_path / "walk", frames=1, fps=10)
    assert list(Walk.from_folder(folder).readings()) == []
    lines = [{"t": 0.0, "type": "wifi", "readings": []}, {"t": 0.02, "type": "gyroscope", "v": [1, 2, 3]}]
    (folder / "sensors.jsonl").write_text("\n".join(json.dumps(line) for line in lines))
    assert list(Walk.from_folder(folder).readings()) == lines
    (folder / "sensors.jsonl").write_text('{"type": "wifi"}')
    with pytest.raises(WalkError, match=r"sensors\.jsonl:1"):
        list(Walk.from_folder(folder).readings())


def test_jpeg_keeps_the_picture_better_with_higher_quality() -> None:
    noise = np.random.default_rng(3).integers(0, 255, (48, 64), dtype=np.uint8)
    image = np.asarray(cv2.cvtColor(cv2.blur(noise, (3, 3)), cv2.COLOR_GRAY2BGR), dtype=np.uint8)
    errors = []
    for quality in (30, 95):
        decoded = cv2.imdecode(np.frombuffer(encode_jpeg(image, quality), np.uint8), cv2.IMREAD_COLOR)
        assert decoded is not None
        errors.append(float(np.abs(decoded.astype(float) - image).mean()))
    assert errors[1] < errors[0] / 2
