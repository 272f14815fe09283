"""Videos that cannot be mapped, through the real build process: each has its reason, the service goes on."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest
import pytest_asyncio
import service
from recorded_video import write_video
from service import Service

from server.api.components import Entries

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def real_builds(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Service]:
    chosen = service.settings(tmp_path_factory.mktemp("data"), max_video_bytes=10_000_000)
    async with service.running(chosen, Entries(engine=service.STUBS.engine)) as running:
        yield running


def video(folder: Path, frames: int, size: tuple[int, int] = (640, 480)) -> bytes:
    path = folder / f"{frames}.mp4"
    write_video(path, frames, 10, size)
    return path.read_bytes()


@pytest.mark.parametrize(
    ("kind", "reason"),
    [
        ("no video", "not_a_video"),
        ("truncated", "not_a_video"),
        ("no frames", "not_a_video"),
        ("short", "too_short"),
        ("another camera's", "camera_mismatch"),
        ("grey", "no_texture"),
    ],
)
async def test_a_video_that_cannot_be_mapped_says_why(
    real_builds: Service, tmp_path: Path, kind: str, reason: str
) -> None:
    content = {
        "no video": lambda: b"This is a letter, not a video. " * 100,
        "truncated": lambda: video(tmp_path, 60)[:2000],
        "no frames": lambda: video(tmp_path, 0) or b"\x00",
        "short": lambda: video(tmp_path, 5),
        "another camera's": lambda: video(tmp_path, 30, (320, 200)),
        "grey": lambda: video(tmp_path, 30),
    }[kind]()
    failed = await real_builds.wait(await real_builds.upload(content), "failed", "ready")
    assert failed["failure"]["reason"] == reason
    assert len(failed["failure"]["detail"]) > 10
    assert (await real_builds.http.get("/v1/health")).json()["status"] == "ok"
