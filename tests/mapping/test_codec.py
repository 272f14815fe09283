"""Route maps as files: what is written comes back, and nothing damaged does."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from server.geometry.cameras import Camera
from server.mapping import codec
from server.mapping.codec import (
    CorruptRouteMapError,
    RouteMapFileError,
    UnsupportedVersionError,
    load_route_map,
    save_route_map,
)
from server.mapping.route_map import (
    Keyframes,
    Landmarks,
    Observations,
    RouteMap,
    RoutePath,
    Scale,
    ScaleSource,
    Turn,
)

PARTS = ("keyframes", "landmarks", "observations", "path")


def _random_map(seed: int = 1, keyframes: int = 4, landmarks: int = 30, frames: int = 9) -> RouteMap:
    """Values without meaning, every bit pattern of them worth keeping."""
    rng = np.random.default_rng(seed)
    seen = [
        rng.permutation(landmarks)[: rng.integers(landmarks // 2, landmarks + 1)] for _ in range(keyframes)
    ]
    landmark = np.concatenate(seen).astype(np.int32)
    count = len(landmark)
    position = rng.normal(size=(landmarks, 3))
    position[0] = [-0.0, 5e-324, 1e308]
    return RouteMap(
        camera=Camera.pinhole(640, 480, 500.25, 1000.0 / 3.0, 320.1, 239.7),
        keyframes=Keyframes(
            np.arange(keyframes, dtype=np.int32) * 2,
            rng.normal(size=(keyframes, 4)),
            rng.normal(size=(keyframes, 3)),
        ),
        landmarks=Landmarks(
            position,
            rng.integers(0, 256, (landmarks, 32), np.uint8),
            rng.normal(size=(landmarks, 3)).astype(np.float32),
            rng.uniform(1, 9, (landmarks, 2)).astype(np.float32),
            rng.integers(0, 8, landmarks, np.int8),
        ),
        observations=Observations(
            np.concatenate([[0], np.cumsum([len(s) for s in seen])]).astype(np.int64),
            landmark,
            rng.uniform(0, 640, (count, 2)).astype(np.float32),
            rng.integers(0, 8, count, np.int8),
            rng.integers(0, 256, (count, 32), np.uint8),
        ),
        path=RoutePath(
            0.1 * np.arange(frames),
            rng.normal(size=(frames, 4)),
            rng.normal(size=(frames, 3)),
            rng.random(frames) < 0.7,
            np.cumsum(rng.random(frames)),
        ),
        turns=(Turn(0.1, 1.0 / 3.0, -1.5), Turn(2.0, 3.5, np.pi / 2)),
        scale=Scale(1.0 / 7.0, ScaleSource.MEASURED_LENGTH),
    )


def _arrays(route_map: RouteMap) -> dict[str, np.ndarray]:
    return {
        f"{part}.{field.name}": getattr(getattr(route_map, part), field.name)
        for part in PARTS
        for field in fields(getattr(route_map, part))
    }


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A written map."""
    path = tmp_path / "route.map"
    save_route_map(_random_map(), path)
    return path


def _edited(file: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    """Change the JSON header of a map file."""
    data = file.read_bytes()
    length = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + length])
    edit(header)
    text = json.dumps(header).encode()
    file.write_bytes(len(text).to_bytes(8, "little") + text + data[8 + length :])


@pytest.mark.parametrize("seed", range(3))
def test_what_is_written_comes_back_bit_for_bit(tmp_path: Path, seed: int) -> None:
    route_map = _random_map(seed, keyframes=3 + seed, landmarks=20 + 7 * seed)
    save_route_map(route_map, tmp_path / "a.map")
    read = load_route_map(tmp_path / "a.map")
    before, after = _arrays(route_map), _arrays(read)
    assert len(before) == 18
    for name, array in before.items():
        assert after[name].dtype == array.dtype, name
        assert after[name].shape == array.shape, name
        assert after[name].tobytes() == array.tobytes(), name
    assert read.camera == route_map.camera
    assert read.turns == route_map.turns
    assert read.scale == route_map.scale


def test_what_was_read_can_be_written_again(file: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.map"
    save_route_map(load_route_map(file), again)
    first, second = _arrays(load_route_map(file)), _arrays(load_route_map(again))
    assert {n: a.tobytes() for n, a in first.items()} == {n: a.tobytes() for n, a in second.items()}
    assert again.stat().st_size == file.stat().st_size


def test_a_map_without_a_known_scale_or_turns_stays_without(tmp_path: Path) -> None:
    save_route_map(replace(_random_map(), scale=Scale(), turns=()), tmp_path / "a.map")
    read = load_route_map(tmp_path / "a.map")
    assert read.scale == Scale(None, ScaleSource.UNKNOWN)
    assert read.turns == ()


def test_a_map_without_landmarks_comes_back_empty(tmp_path: Path) -> None:
    route_map = _random_map(landmarks=2)
    empty = replace(
        route_map,
        landmarks=Landmarks(**{f.name: getattr(route_map.landmarks, f.name)[:0] for f in fields(Landmarks)}),
        observations=Observations(
            np.zeros(5, np.int64),
            *(getattr(route_map.observations, f.name)[:0] for f in fields(Observations)[1:]),
        ),
    )
    save_route_map(empty, tmp_path / "a.map")
    assert len(load_route_map(tmp_path / "a.map").landmarks) == 0


def test_arrays_are_read_only_views_of_the_file(file: Path) -> None:
    data = file.read_bytes()
    read = _arrays(load_route_map(file))
    for name, array in read.items():
        assert isinstance(array, np.memmap), name
        owner = array
        while isinstance(owner.base, np.ndarray):
            owner = owner.base
        assert isinstance(owner, np.memmap)
        assert Path(str(owner.filename)) == file
        assert not array.flags.writeable, name
    # One mapping of the file carries them all, side by side.
    spans = sorted((a.__array_interface__["data"][0], a.nbytes) for a in read.values())
    assert spans[-1][0] + spans[-1][1] - spans[0][0] <= len(data)
    with pytest.raises(ValueError, match="read-only"):
        read["landmarks.position"][0, 0] = 1.0


def test_a_file_cut_short_anywhere_is_refused(file: Path) -> None:
    data = file.read_bytes()
    lengths = {*range(0, 64), *np.linspace(64, len(data) - 1, 200).astype(int).tolist(), len(data) - 1}
    for length in sorted(lengths):
        file.write_bytes(data[:length])
        with pytest.raises(CorruptRouteMapError):
            load_route_map(file)


def test_a_flipped_bit_in_the_data_is_noticed(file: Path) -> None:
    data = file.read_bytes()
    start = 8 + int.from_bytes(data[:8], "little")
    rng = np.random.default_rng(5)
    used = sum(a.nbytes for a in _arrays(_random_map()).values())
    assert used == len(data) - start
    for at in {start, len(data) - 1, *rng.integers(start, len(data), 200).tolist()}:
        damaged = bytearray(data)
        damaged[at] ^= 1 << int(rng.integers(8))
        file.write_bytes(damaged)
        with pytest.raises(CorruptRouteMapError):
            load_route_map(file)


def test_a_flipped_bit_in_the_header_is_noticed_or_changes_nothing(file: Path) -> None:
    """Camera, scale and turns lie in the header: none of them may come back otherwise than written."""
    data = file.read_bytes()
    length = int.from_bytes(data[:8], "little")
    truth = _random_map()
    arrays = {name: array.tobytes() for name, array in _arrays(truth).items()}
    noticed = 0
    flips = range(0, 8 + length, 3)
    for at in flips:
        damaged = bytearray(data)
        damaged[at] ^= 1 << (at % 5)
        file.write_bytes(damaged)
        try:
            read = load_route_map(file)
        except RouteMapFileError:
            noticed += 1
            continue
        assert (read.camera, read.turns, read.scale) == (truth.camera, truth.turns, truth.scale), at
        assert {name: array.tobytes() for name, array in _arrays(read).items()} == arrays
    assert noticed > 0.8 * len(flips)


def test_damage_is_still_found_by_shape_when_nobody_verifies(file: Path) -> None:
    data = file.read_bytes()
    damaged = bytearray(data)
    damaged[-1] ^= 0xFF
    file.write_bytes(damaged)
    load_route_map(file, verify=False)
    file.write_bytes(data[:-1])
    with pytest.raises(CorruptRouteMapError, match="cut short"):
        load_route_map(file, verify=False)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0" * 7,
        b"\0" * 200,
        b"not a route map at all, but a text that somebody uploaded",
        (20).to_bytes(8, "little") + b"{" * 20,
        (2).to_bytes(8, "little") + b"{}",
        (2).to_bytes(8, "little") + b"[]",
        (4).to_bytes(8, "little") + b"null",
        (2).to_bytes(8, "little") + b"\xff\xfe",
        (20).to_bytes(8, "little") + b'{"__metadata__": 12}',
        (100_000).to_bytes(8, "little") + b"[" * 100_000,
        (1 << 62).to_bytes(8, "little") + b"{}",
    ],
)
def test_what_is_no_route_map_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.map"
    path.write_bytes(content)
    with pytest.raises(CorruptRouteMapError):
        load_route_map(path)


def test_a_missing_file_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load_route_map(tmp_path / "nothing.map")


def _set(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def edit(header: dict[str, Any]) -> None:
        *outer, last = path.split("/")
        inner = header
        for key in outer:
            inner = inner[key]
        inner[last] = value

    return edit


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("__metadata__/format", "another"),
        ("__metadata__/version", "one"),
        ("__metadata__/camera", "{}"),
        ("__metadata__/camera", "["),
        ("__metadata__/scale", '{"metres_per_unit": 1, "source": "guess"}'),
        ("__metadata__/turns", "[[1, 2]]"),
        ("__metadata__/checksum", "0"),
        ("__metadata__/checksum", "x"),
        ("path.time/dtype", "F32"),
        ("path.time/shape", [-9]),
        ("path.time/shape", [3, 3]),
        ("path.time/data_offsets", [-72, 0]),
        ("path.time/data_offsets", [0, 1 << 60]),
        ("path.time/data_offsets", [float("inf"), 0]),
        ("path.time/data_offsets", [0]),
        ("path.time", None),
        ("keyframes.frame", {}),
    ],
)
def test_a_header_that_lies_is_refused(file: Path, path: str, value: Any) -> None:
    _edited(file, _set(path, value))
    with pytest.raises(CorruptRouteMapError):
        load_route_map(file)


def test_a_missing_array_is_refused(file: Path) -> None:
    _edited(file, lambda header: header.pop("landmarks.octave") and None)
    with pytest.raises(CorruptRouteMapError):
        load_route_map(file)


def test_a_map_of_a_later_version_says_so(file: Path) -> None:
    later = str(codec.FORMAT_VERSION + 1)
    _edited(file, _set("__metadata__/version", later))
    with pytest.raises(UnsupportedVersionError, match=f"version {later}.*update"):
        load_route_map(file)


@pytest.mark.parametrize("wrong", [30, -1, 2**31 - 1])
def test_an_observation_of_a_missing_landmark_is_refused(tmp_path: Path, wrong: int) -> None:
    route_map = _random_map()
    route_map.observations.landmark[7] = wrong
    save_route_map(route_map, tmp_path / "a.map")
    with pytest.raises(CorruptRouteMapError, match="landmark"):
        load_route_map(tmp_path / "a.map")


@pytest.mark.parametrize("change", ["first", "last", "order"])
def test_offsets_that_do_not_partition_the_observations_are_refused(tmp_path: Path, change: str) -> None:
    route_map = _random_map()
    offsets = route_map.observations.offsets
    if change == "first":
        offsets[0] = 1
    elif change == "last":
        offsets[-1] -= 1
    else:
        offsets[[1, 2]] = offsets[[2, 1]]
    save_route_map(route_map, tmp_path / "a.map")
    with pytest.raises(CorruptRouteMapError, match="keyframe"):
        load_route_map(tmp_path / "a.map")


def test_a_failed_write_leaves_the_old_map_and_nothing_else(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = file.read_bytes()

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(codec.os, "fsync", full)
    with pytest.raises(OSError, match="No space"):
        save_route_map(_random_map(2), file)
    assert file.read_bytes() == before
    assert [p.name for p in file.parent.iterdir()] == [file.name]


def test_a_write_that_fails_at_the_first_byte_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        save_route_map(_random_map(), tmp_path / "missing" / "a.map")
    assert list(tmp_path.iterdir()) == []


def test_a_reader_keeps_the_map_it_opened_while_another_is_written(file: Path) -> None:
    read = load_route_map(file)
    truth = _random_map().landmarks.position.tobytes()
    save_route_map(_random_map(9, landmarks=12), file)
    assert read.landmarks.position.tobytes() == truth
    assert len(load_route_map(file).landmarks) == 12
