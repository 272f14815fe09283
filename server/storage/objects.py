"""The object store: videos, maps and other large things, by key.

A key is made of segments of letters, digits, ``-``, ``_`` and ``.`` divided by ``/``; it is no path.
An object is there whole or not at all, and never changes.
"""

from __future__ import annotations

import asyncio
import errno
import os
import re
import shutil
import time
from collections.abc import AsyncIterable, AsyncIterator, Sequence
from pathlib import Path
from typing import IO, Protocol
from uuid import uuid4

_KEY = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*(?:/[A-Za-z0-9][A-Za-z0-9._-]*)*")
_CHUNK = 1 << 20

STORAGE_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
"""Numbers of the errors that mean that there is no room: on the disk, for the user, for one file."""


class InvalidKeyError(ValueError):
    """A key that is none."""


class ObjectMissingError(LookupError):
    """No object has this key."""


class NoRoomError(Exception):
    """There is no room left; nothing was stored."""


class ObjectTooLargeError(Exception):
    """A stream was longer than allowed; nothing was stored.

    Attributes:
        limit: bytes.
    """

    def __init__(self, limit: int) -> None:
        super().__init__(f"longer than {limit} bytes")
        self.limit = limit


class ObjectStore(Protocol):
    """Where large things are kept.

    Every method raises :class:`InvalidKeyError` for a malformed key.
    """

    async def put(self, key: str, chunks: AsyncIterable[bytes], *, limit: int) -> int:
        """Store a stream under a key; returns its length in bytes.

        Raises:
            ObjectTooLargeError: more than ``limit`` bytes came.
            NoRoomError: there is no room for it.
        """
        ...

    async def put_file(self, key: str, path: Path) -> int:
        """Move a finished local file into the store; returns its length in bytes.

        Raises:
            NoRoomError: there is no room for it.
        """
        ...

    async def size(self, key: str) -> int:
        """Length in bytes.

        Raises:
            ObjectMissingError: there is no such object.
        """
        ...

    def read(self, key: str) -> AsyncIterator[bytes]:
        """The object in chunks.

        Raises:
            ObjectMissingError: there is no such object.
        """
        ...

    async def local_path(self, key: str) -> Path:
        """A local file with the object's content, to be read only.

        Raises:
            ObjectMissingError: there is no such object.
        """
        ...

    async def scratch(self) -> Path:
        """A new empty folder for intermediate files, on the file system :meth:`put_file` is cheap from."""
        ...

    async def delete(self, keys: Sequence[str]) -> None:
        """Remove objects; missing ones are no error."""
        ...

    async def keys(self, prefix: str, *, older_than_s: float = 0.0) -> list[str]:
        """Keys under a prefix (whole segments) of objects at least so old."""
        ...


class FolderObjectStore:
    """An :class:`ObjectStore` in a folder: written to a temporary file, synced, then renamed.

    Args:
        root: created if missing. What an earlier process left unfinished in it is removed.
    """

    def __init__(self, root: Path) -> None:
        self._objects = root / "objects"
        self._unfinished = root / "unfinished"
        self._objects.mkdir(parents=True, exist_ok=True)
        self._unfinished.mkdir(exist_ok=True)

    def _path(self, key: str) -> Path:
        if len(key) > 256 or not _KEY.fullmatch(key) or ".." in key:
            raise InvalidKeyError(f"not an object key: {key[:80]!r}")
        return self._objects / key

    async def put(self, key: str, chunks: AsyncIterable[bytes], *, limit: int) -> int:
        """See :meth:`ObjectStore.put`."""
        target = self._path(key)
        temporary = self._unfinished / uuid4().hex
        total = 0
        try:
            # Unbuffered: what a full disk did not take would be written once more on closing.
            file = await asyncio.to_thread(temporary.open, "wb", buffering=0)
            with file:
                async for chunk in chunks:
                    total += len(chunk)
                    if total > limit:
                        raise ObjectTooLargeError(limit)
                    await asyncio.to_thread(_write, file, chunk)
                await asyncio.to_thread(_publish, file, temporary, target)
        except BaseException as error:
            temporary.unlink(missing_ok=True)
            if isinstance(error, OSError) and error.errno in STORAGE_FULL:
                raise NoRoomError(key) from None
            raise
        return total

    async def put_file(self, key: str, path: Path) -> int:
        """See :meth:`ObjectStore.put_file`."""
        target = self._path(key)
        return await asyncio.to_thread(self._adopt, path, target)

    def _adopt(self, path: Path, target: Path) -> int:
        temporary = self._unfinished / uuid4().hex
        try:
            shutil.move(path, temporary)
            with temporary.open("rb") as file:
                _publish(file, temporary, target)
        except OSError as error:
            temporary.unlink(missing_ok=True)
            if error.errno in STORAGE_FULL:
                raise NoRoomError(target.name) from None
            raise
        return target.stat().st_size

    async def size(self, key: str) -> int:
        """See :meth:`ObjectStore.size`."""
        try:
            return (await asyncio.to_thread(self._path(key).stat)).st_size
        except FileNotFoundError:
            raise ObjectMissingError(key) from None

    async def read(self, key: str) -> AsyncIterator[bytes]:
        """See :meth:`ObjectStore.read`."""
        try:
            file = await asyncio.to_thread(self._path(key).open, "rb")
        except FileNotFoundError:
            raise ObjectMissingError(key) from None
        try:
            while chunk := await asyncio.to_thread(file.read, _CHUNK):
                yield chunk
        finally:
            file.close()

    async def local_path(self, key: str) -> Path:
        """See :meth:`ObjectStore.local_path`."""
        await self.size(key)
        return self._path(key)

    async def scratch(self) -> Path:
        """See :meth:`ObjectStore.scratch`."""
        folder = self._unfinished / uuid4().hex
        await asyncio.to_thread(folder.mkdir)
        return folder

    async def delete(self, keys: Sequence[str]) -> None:
        """See :meth:`ObjectStore.delete`."""
        await asyncio.to_thread(self._delete, [self._path(key) for key in keys])

    def _delete(self, paths: Sequence[Path]) -> None:
        for path in paths:
            path.unlink(missing_ok=True)
            folder = path.parent
            while folder != self._objects and folder.is_dir() and not any(folder.iterdir()):
                folder.rmdir()
                folder = folder.parent

    async def keys(self, prefix: str, *, older_than_s: float = 0.0) -> list[str]:
        """See :meth:`ObjectStore.keys`."""
        return await asyncio.to_thread(self._list, self._path(prefix), older_than_s)

    def _list(self, folder: Path, older_than_s: float) -> list[str]:
        newest = time.time() - older_than_s
        return sorted(
            path.relative_to(self._objects).as_posix()
            for path in folder.rglob("*")
            if path.is_file() and path.stat().st_mtime <= newest
        )

    async def sweep_unfinished(self) -> None:
        """Remove what a process that died left half written. Only while nobody else uses the folder."""
        await asyncio.to_thread(self._sweep_unfinished)

    def _sweep_unfinished(self) -> None:
        for path in self._unfinished.iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            else:
                path.unlink()


def _write(file: IO[bytes], chunk: bytes) -> None:
    rest = memoryview(chunk)
    while rest:
        rest = rest[file.write(rest) :]


def _publish(file: IO[bytes], temporary: Path, target: Path) -> None:
    """Make a written file durable under its final name."""
    if file.writable():
        file.flush()
    os.fsync(file.fileno())
    file.close()
    # A deletion may remove the folder, empty for a moment, between the two calls.
    for attempt in range(3):
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            temporary.replace(target)
            break
        except FileNotFoundError:
            if attempt == 2 or not temporary.exists():
                raise
    folder = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
