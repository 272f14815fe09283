"""Recordings as they come: a folder, or a folder of archives."""

from __future__ import annotations

import lzma
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class RecordingError(Exception):
    """A folder holds nothing that can be judged; the message says what was looked for."""


@contextmanager
def unpacked(folder: Path, pattern: str) -> Iterator[list[Path]]:
    """Files below ``folder`` that match ``pattern``, or, if there are none, those in its ``*.tar.xz``.

    Raises:
        RecordingError: neither has one, or an archive is broken.
    """
    if not folder.is_dir():
        raise RecordingError(f"{folder} is not a folder")
    files = sorted(folder.rglob(pattern))
    if files:
        yield files
        return
    with tempfile.TemporaryDirectory(prefix="pairnavi-recordings-") as temporary:
        for archive in sorted(folder.rglob("*.tar.xz")):
            try:
                with tarfile.open(archive, "r:xz") as tar:
                    tar.extractall(temporary, filter="data")
            except (tarfile.TarError, lzma.LZMAError, EOFError, OSError) as error:
                raise RecordingError(f"{archive} cannot be unpacked: {error}") from error
        files = sorted(Path(temporary).rglob(pattern))
        if not files:
            raise RecordingError(f"{folder} has no {pattern}, nor a .tar.xz that holds one")
        yield files
