"""Decoding: which frames are taken, when they were, which way up, and what is no video."""

from __future__ import annotations

import contextlib
import resource
import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from mp4_boxes import add_tracks, as_audio, declare_size, edit_list, repeat, retime, rotate

from server.geometry.cameras import Camera
from server.mapping.build import _upright
from server.mapping.video import UnreadableVideoError, VideoFrame, probe, read_frames

SIZE = (64, 48)
BITS = 8


def _numbered(path: Path, frames: int, fps: float) -> Path:
    """Frames that carry their number: eight upright bars, white for a one, lowest bit on the left."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), fps, SIZE)
    bars = np.arange(SIZE[0]) * BITS // SIZE[0]
    for number in range(frames):
        row = np.where(number >> bars & 1, 230, 25).astype(np.uint8)
        writer.write(np.broadcast_to(row[None, :, None], (SIZE[1], SIZE[0], 3)).copy())
    writer.release()
    return path


def _number(frame: VideoFrame) -> int:
    bars = frame.image.reshape(SIZE[1], BITS, -1).mean(axis=(0, 2))
    return int((bars > 128) @ (1 << np.arange(BITS)))


@pytest.mark.parametrize("fps", [10, 15, 24, 25, 29.97, 30, 60])
def test_any_frame_rate_is_sampled_to_ten_a_second(tmp_path: Path, fps: float) -> None:
    count = round(4 * fps)
    frames = list(read_frames(_numbered(tmp_path / "a.mp4", count, fps)))
    assert len(frames) == pytest.approx(40, abs=1)
    times = np.array([frame.time for frame in frames])
    index = np.array([frame.index for frame in frames])
    # The picture is the one its index and its time say.
    np.testing.assert_array_equal([_number(frame) for frame in frames], index)
    np.testing.assert_allclose(times, index / fps, atol=1.5e-3)
    # Never further from the tenth of a second that was meant than a frame of the video.
    np.testing.assert_allclose(times, 0.1 * np.arange(len(times)), atol=1 / fps + 2e-3)
    assert all(frame.image.dtype == np.uint8 and frame.image.shape == (48, 64) for frame in frames)


def test_a_slower_video_gives_every_frame(tmp_path: Path) -> None:
    frames = list(read_frames(_numbered(tmp_path / "a.mp4", 21, 7)))
    assert [frame.index for frame in frames] == list(range(21))
    np.testing.assert_allclose([frame.time for frame in frames], np.arange(21) / 7, atol=1.5e-3)


def test_another_rate_can_be_asked_for(tmp_path: Path) -> None:
    frames = list(read_frames(_numbered(tmp_path / "a.mp4", 60, 30), frame_rate=5.0))
    assert [frame.index for frame in frames] == list(range(0, 60, 6))


def test_a_variable_frame_rate_is_sampled_by_time_not_by_count(tmp_path: Path) -> None:
    """A phone in the dark: 30 frames a second, then a burst, then half a second nothing, then 12."""
    durations = [33] * 30 + [8] * 50 + [500] + [83] * 24
    video = _numbered(tmp_path / "a.mp4", len(durations), 30)
    retime(video, durations)
    stamps = np.concatenate([[0], np.cumsum(durations)[:-1]]) / 1000
    frames = list(read_frames(video))
    times = np.array([frame.time for frame in frames])
    np.testing.assert_array_equal([_number(frame) for frame in frames], [frame.index for frame in frames])
    np.testing.assert_allclose(times, stamps[[frame.index for frame in frames]], atol=2e-3)
    # The burst's 50 frames last 0.4 s; the gap stays a gap and nothing makes up for it afterwards.
    burst = (times > 0.995) & (times < 1.39)
    assert 3 <= burst.sum() <= 5
    assert np.diff(times).max() == pytest.approx(0.5, abs=0.11)
    assert np.diff(times).min() > 0.048
    late = times[times > 2.0]
    assert len(late) / (late[-1] - late[0]) <= 11.0
    for second in (0.0, 2.0, 2.5):
        assert ((times >= second) & (times < second + 1.0)).sum() <= 11


def test_probe_tells_what_the_container_says(tmp_path: Path) -> None:
    said = probe(_numbered(tmp_path / "a.mp4", 45, 15))
    assert (said.width, said.height, said.frames, said.quarter_turns) == (64, 48, 45, 0)
    assert said.frame_rate == pytest.approx(15.0)
    assert said.seconds == pytest.approx(3.0)


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_rotation_metadata_turns_the_picture_and_the_camera(tmp_path: Path, turns: int) -> None:
    """A phone filming upright stores a lying picture: what is decoded and its camera must agree."""
    stored = np.full((SIZE[1], SIZE[0], 3), 30, np.uint8)
    stored[6:16, 40:56] = 240  # its centre is (48, 11)
    path = tmp_path / "a.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 10, SIZE)
    for _ in range(3):
        writer.write(stored)
    writer.release()
    rotate(path, turns)
    said = probe(path)
    assert said.quarter_turns == turns
    assert (said.width, said.height) == ((64, 48) if turns % 2 == 0 else (48, 64))
    shown = next(read_frames(path)).image
    assert shown.shape == (said.height, said.width)
    rows, columns = np.nonzero(shown > 135)
    seen = np.array([columns.mean() + 0.5, rows.mean() + 0.5])
    # The camera as the phone describes it, of the stored picture, has its centre on the bright patch.
    camera = Camera.pinhole(64, 48, 60.0, 70.0, 48.0, 11.0)
    upright = _upright(camera, said.width, said.height, said.quarter_turns)
    assert upright is not None
    if turns in (1, 3):
        assert upright.focal == (70.0, 60.0)
        np.testing.assert_allclose(upright.centre, seen, atol=0.6)


def test_the_camera_of_an_upright_picture_is_taken_as_it_is() -> None:
    camera = Camera.pinhole(480, 640, 500.0, 501.0, 230.0, 330.0)
    assert _upright(camera, 480, 640, 1) == camera


@pytest.mark.parametrize(
    ("size", "turns", "expected"),
    [
        ((640, 480), 1, (480, 640, 510.0, 500.0, 250.0, 310.0)),
        ((640, 480), 3, (480, 640, 510.0, 500.0, 230.0, 330.0)),
        ((1280, 960), 0, (1280, 960, 1000.0, 1020.0, 620.0, 460.0)),
        ((1280, 960), 1, (960, 1280, 1020.0, 1000.0, 500.0, 620.0)),
    ],
)
def test_a_camera_is_turned_and_scaled_to_its_video(
    size: tuple[int, int], turns: int, expected: tuple[float, ...]
) -> None:
    camera = Camera.pinhole(640, 480, 500.0, 510.0, 310.0, 230.0)
    width, height = size if turns % 2 == 0 else size[::-1]
    upright = _upright(camera, width, height, turns)
    assert upright is not None
    assert (upright.width, upright.height) == (width, height) == expected[:2]
    np.testing.assert_allclose(upright.params, expected[2:])


def test_a_camera_of_another_shape_fits_no_video() -> None:
    assert _upright(Camera.pinhole(640, 360, 500, 500, 320, 180), 640, 480, 0) is None
    assert _upright(Camera.pinhole(640, 480, 500, 500, 320, 240), 480, 640, 0) is None


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no video",
        b"\0" * 5000,
        b"#EXTM3U\n#EXTINF:1,\n/etc/passwd\n",
        b"  \n#EXTM3U\nhttp://127.0.0.1:1/a.ts\n",
        b"\x89PNG\r\n\x1a\n" + b"\0" * 100,
        b"\0\0\0\x18ftypmp42\0\0\0\0mp42isom",
    ],
)
def test_what_is_no_video_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(content)
    with pytest.raises(UnreadableVideoError):
        probe(path)
    with pytest.raises(UnreadableVideoError):
        list(read_frames(path))


@pytest.mark.parametrize("name", ["a.m3u8", "a.mpd", "a.sdp", "a.ffconcat", "A.TXT"])
def test_a_playlist_is_not_followed(tmp_path: Path, name: str) -> None:
    _numbered(tmp_path / "real.mp4", 5, 10)
    playlist = tmp_path / name
    playlist.write_text("ffconcat version 1.0\nfile real.mp4\n", encoding="utf-8")
    with pytest.raises(UnreadableVideoError, match="playlist"):
        probe(playlist)


@pytest.mark.parametrize(
    "text",
    [
        "ffconcat version 1.0\nfile real.mp4\n",
        '<?xml version="1.0"?><MPD xmlns="urn:mpeg:dash:schema:mpd:2011"><Period/></MPD>',
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nm=video 9 RTP/AVP 96\n",
        "#EXTINF:1,\nreal.mp4\n",
    ],
)
def test_a_playlist_by_another_name_is_not_followed_either(tmp_path: Path, text: str) -> None:
    """An upload has no name of its own: the content alone decides."""
    _numbered(tmp_path / "real.mp4", 5, 10)
    upload = tmp_path / "video"
    upload.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableVideoError):
        list(read_frames(upload))


def test_a_missing_file_is_no_video(tmp_path: Path) -> None:
    with pytest.raises(UnreadableVideoError, match="missing"):
        probe(tmp_path / "nothing.mp4")
    with pytest.raises(UnreadableVideoError):
        probe(tmp_path)


def test_a_video_cut_before_its_index_is_refused(tmp_path: Path) -> None:
    path = _numbered(tmp_path / "a.mp4", 40, 10)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(UnreadableVideoError):
        list(read_frames(path))


def test_a_video_that_breaks_off_ends_where_it_breaks_off(tmp_path: Path) -> None:
    """AVI has its frames in the order they were filmed: the first ones survive."""
    path = tmp_path / "a.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, SIZE)
    rng = np.random.default_rng(1)
    for _ in range(40):
        writer.write(rng.integers(0, 256, (SIZE[1], SIZE[0], 3), np.uint8))
    writer.release()
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    frames = list(read_frames(path))
    assert 10 <= len(frames) <= 25
    np.testing.assert_allclose([frame.time for frame in frames], 0.1 * np.arange(len(frames)), atol=2e-3)


def test_pictures_too_small_to_use_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (8, 8))
    for _ in range(5):
        writer.write(np.zeros((8, 8, 3), np.uint8))
    writer.release()
    with pytest.raises(UnreadableVideoError, match="size"):
        probe(path)


@pytest.mark.parametrize("ticks", [0, 1])
def test_the_same_bytes_named_as_a_million_frames_are_not_all_decoded(tmp_path: Path, ticks: int) -> None:
    path = _numbered(tmp_path / "a.mp4", 1, 10)
    repeat(path, 1_000_000, ticks)
    assert probe(path).frames == 1_000_000
    begun = time.process_time()
    with pytest.raises(UnreadableVideoError, match="300 frames a second"):
        list(read_frames(path))
    assert time.process_time() - begun < 5.0


def test_slow_motion_is_no_bomb(tmp_path: Path) -> None:
    assert len(list(read_frames(_numbered(tmp_path / "a.mp4", 2900, 240)))) == pytest.approx(121, abs=1)


def test_4k_at_60_frames_a_second_converts_only_what_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), 60, (3840, 2160))
    picture = cv2.resize(np.random.default_rng(1).integers(0, 256, (27, 48, 3), np.uint8), (3840, 2160))
    for _ in range(30):
        writer.write(picture)
    writer.release()
    converted = []
    real = cv2.cvtColor
    monkeypatch.setattr(cv2, "cvtColor", lambda *arguments: converted.append(1) or real(*arguments))
    frames = list(read_frames(path))
    assert [frame.index for frame in frames] == [0, 6, 12, 18, 24]
    assert frames[0].image.shape == (2160, 3840)
    assert len(converted) == 5


def test_a_still_picture_repeated_is_a_video(tmp_path: Path) -> None:
    path = _numbered(tmp_path / "a.mp4", 1, 10)
    repeat(path, 30, 1000)
    frames = list(read_frames(path))
    assert 25 <= len(frames) <= 30
    np.testing.assert_array_equal(frames[0].image, frames[-1].image)


def test_a_still_picture_by_a_videos_name_is_refused(tmp_path: Path) -> None:
    done, picture = cv2.imencode(".jpg", np.full((48, 64), 128, np.uint8))
    assert done
    path = tmp_path / "a.mp4"
    path.write_bytes(picture.tobytes())
    with pytest.raises(UnreadableVideoError, match="no MP4"):
        probe(path)


def test_a_declared_size_takes_no_memory(tmp_path: Path) -> None:
    path = _numbered(tmp_path / "a.mp4", 5, 10)
    declare_size(path, 65535, 65535)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with contextlib.suppress(UnreadableVideoError):
        # The pictures themselves say what they are.
        assert {frame.image.shape for frame in read_frames(path)} <= {(48, 64)}
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000


def test_pictures_beyond_8k_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (8192, 4352))
    writer.write(np.zeros((4352, 8192, 3), np.uint8))
    writer.release()
    with pytest.raises(UnreadableVideoError, match="8K"):
        probe(path)


def test_hundred_thousand_tracks_are_refused_quickly(tmp_path: Path) -> None:
    path = _numbered(tmp_path / "a.mp4", 5, 10)
    add_tracks(path, 99_999)
    begun = time.process_time()
    with pytest.raises(UnreadableVideoError):
        probe(path)
    assert time.process_time() - begun < 5.0


def test_a_second_track_is_not_looked_at(tmp_path: Path) -> None:
    path = _numbered(tmp_path / "a.mp4", 20, 10)
    add_tracks(path, 1)
    assert [_number(frame) for frame in read_frames(path)] == list(range(20))


def test_sound_alone_is_no_video(tmp_path: Path) -> None:
    path = _numbered(tmp_path / "a.mp4", 5, 10)
    as_audio(path)
    with pytest.raises(UnreadableVideoError):
        list(read_frames(path))


@pytest.mark.parametrize(
    "entries",
    [
        [(2**32 - 1, -1), (1000, 0)],
        [(1, 2**31 - 1)],
        [(0, 0)] * 1000,
        [(1000, 0)] * 1500,
        [(2**32 - 1, 0), (2**32 - 1, -1)],
    ],
)
def test_absurd_edit_lists_end(tmp_path: Path, entries: list[tuple[int, int]]) -> None:
    path = _numbered(tmp_path / "a.mp4", 20, 10)
    edit_list(path, entries)
    begun = time.process_time()
    times = []
    with contextlib.suppress(UnreadableVideoError):
        times = [frame.time for frame in read_frames(path)]
    assert time.process_time() - begun < 5.0
    assert np.all(np.diff(times) > 0)


@pytest.mark.parametrize("milliseconds", [0, 3_600_000])
def test_absurd_durations_end(tmp_path: Path, milliseconds: int) -> None:
    path = _numbered(tmp_path / "a.mp4", 20, 10)
    retime(path, [milliseconds] * 20)
    assert probe(path).seconds >= 0.0
    times = [frame.time for frame in read_frames(path)]
    assert np.all(np.diff(times) > 0)
    assert len(times) == (1 if milliseconds == 0 else 20)
