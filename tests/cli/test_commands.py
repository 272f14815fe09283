from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest
from recorded_video import write_walk
from typer.testing import CliRunner

from server.cli import app

runner = CliRunner()


def test_help_lists_the_commands_and_is_quick() -> None:
    begun = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "server.cli", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert time.monotonic() - begun < 5
    for command in ("serve", "sim", "demo", "evaluate"):
        assert command in done.stdout
    for heavy in ("cv2", "numpy", "fastapi", "sqlalchemy", "matplotlib"):
        assert f"| {heavy}\n" not in done.stderr


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["sim", "leader", "nowhere"], "no such folder"),
        (["sim", "follower", "nowhere", "--route", "x"], "no such folder"),
        (["sim", "leader", "WALK", "--server", "http://127.0.0.1:9"], "http://127.0.0.1:9"),
        (["sim", "follower", "WALK", "--route", "x", "--server", "http://127.0.0.1:9"], "ws://127.0.0.1:9"),
        (["demo", "--leader", "a.mp4"], "together"),
        (["demo", "--leader-camera", "a.json"], "give --leader and --follower too"),
        (["demo", "--leader", "a.mp4", "--follower", "b.mp4"], "a.mp4: no such file"),
    ],
)
def test_what_cannot_work_is_one_line_and_exit_code_1(
    tmp_path: Path, arguments: list[str], complaint: str
) -> None:
    walk = write_walk(tmp_path / "walk", frames=2, fps=10)
    done = runner.invoke(app, [str(walk) if a == "WALK" else a for a in arguments])
    assert done.exit_code == 1
    assert complaint in done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("pairnavi: ")
    assert "Traceback" not in done.stderr


def test_an_address_in_use_is_said(tmp_path: Path) -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        done = runner.invoke(app, ["serve", "--port", str(port), "--data", str(tmp_path)])
    assert done.exit_code == 1
    assert f"cannot listen on 127.0.0.1:{port}" in done.stderr
