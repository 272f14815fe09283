from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from server.storage.objects import (
    FolderObjectStore,
    InvalidKeyError,
    ObjectMissingError,
    ObjectTooLargeError,
)


@pytest.fixture
def store(tmp_path: Path) -> FolderObjectStore:
    return FolderObjectStore(tmp_path / "store")


async def stream(*chunks: bytes) -> AsyncIterator[bytes]:
    for chunk in chunks:
        yield chunk


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


async def content(store: FolderObjectStore, key: str) -> bytes:
    return b"".join([chunk async for chunk in store.read(key)])


async def test_what_is_put_is_read(store: FolderObjectStore) -> None:
    assert await store.put("routes/a/video-1", stream(b"abc", b"", b"def"), limit=6) == 6
    assert await content(store, "routes/a/video-1") == b"abcdef"
    assert await store.size("routes/a/video-1") == 6
    assert (await store.local_path("routes/a/video-1")).read_bytes() == b"abcdef"


async def test_a_stream_that_is_too_long_or_breaks_leaves_nothing(
    store: FolderObjectStore, tmp_path: Path
) -> None:
    async def broken() -> AsyncIterator[bytes]:
        yield b"abc"
        raise ConnectionError

    with pytest.raises(ObjectTooLargeError):
        await store.put("a", stream(b"abc", b"def"), limit=5)
    with pytest.raises(ConnectionError):
        await store.put("a", broken(), limit=5)
    with pytest.raises(ObjectMissingError):
        await store.size("a")
    assert await asyncio.to_thread(files, tmp_path) == []


async def test_an_object_under_way_is_not_seen(store: FolderObjectStore) -> None:
    half = asyncio.Event()
    go_on = asyncio.Event()

    async def slow() -> AsyncIterator[bytes]:
        yield b"first half"
        half.set()
        await go_on.wait()
        yield b", second"

    putting = asyncio.create_task(store.put("routes/a", slow(), limit=100))
    await half.wait()
    assert await store.keys("routes") == []
    go_on.set()
    await putting
    assert await store.keys("routes") == ["routes/a"]


@pytest.mark.parametrize(
    "key",
    [
        "",
        "/etc/passwd",
        "..",
        "a/../b",
        "a//b",
        "a/",
        ".hidden",
        "a/.b",
        "a\\b",
        "a b",
        "a\n",
        "é",
        "x" * 300,
    ],
)
async def test_what_is_no_key_is_refused_everywhere(store: FolderObjectStore, key: str) -> None:
    with pytest.raises(InvalidKeyError):
        await store.put(key, stream(b"x"), limit=5)
    with pytest.raises(InvalidKeyError):
        await content(store, key)
    with pytest.raises(InvalidKeyError):
        await store.delete([key])
    with pytest.raises(InvalidKeyError):
        await store.keys(key)


async def test_missing_objects_say_so(store: FolderObjectStore) -> None:
    for asking in (store.size("a/b"), store.local_path("a/b"), content(store, "a/b")):
        with pytest.raises(ObjectMissingError):
            await asking
    await store.delete(["a/b"])
    assert await store.keys("a") == []


async def test_a_finished_file_is_moved_in(store: FolderObjectStore) -> None:
    folder = await store.scratch()
    (folder / "map").write_bytes(b"map")
    assert await store.put_file("routes/a/map-1", folder / "map") == 3
    assert not (folder / "map").exists()
    assert await content(store, "routes/a/map-1") == b"map"


async def test_deleting_removes_emptied_folders_and_nothing_else(
    store: FolderObjectStore, tmp_path: Path
) -> None:
    for key in ("routes/a/1", "routes/a/2", "routes/b/1"):
        await store.put(key, stream(b"x"), limit=5)
    assert await store.keys("routes/a") == ["routes/a/1", "routes/a/2"]
    await store.delete(["routes/a/1", "routes/a/2"])
    assert await store.keys("routes") == ["routes/b/1"]
    assert not (tmp_path / "store" / "objects" / "routes" / "a").exists()


async def test_keys_can_be_asked_by_age(store: FolderObjectStore) -> None:
    for key in ("r/old", "r/new"):
        await store.put(key, stream(b"x"), limit=5)
    path = await store.local_path("r/old")
    os.utime(path, (path.stat().st_atime, path.stat().st_mtime - 3600))
    assert await store.keys("r", older_than_s=1800) == ["r/old"]


async def test_what_a_dead_process_left_is_swept(store: FolderObjectStore, tmp_path: Path) -> None:
    (await store.scratch() / "half").write_bytes(b"x")
    (tmp_path / "store" / "unfinished" / "upload").write_bytes(b"x")
    await store.put("kept", stream(b"x"), limit=5)
    await store.sweep_unfinished()
    assert list((tmp_path / "store" / "unfinished").iterdir()) == []
    assert await store.size("kept") == 1
