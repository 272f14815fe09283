"""What the image is built from, read off its files."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text(encoding="utf-8")


def test_everything_that_is_installed_is_locked() -> None:
    installs = re.findall(r"^RUN pip install (.*)$", DOCKERFILE, flags=re.MULTILINE)
    assert len(installs) == 2
    locked, project = installs
    assert "--require-hashes" in locked
    files = re.findall(r"-r (\S+)", locked)
    assert files == ["requirements/build.txt", "requirements/postgres.txt"]
    assert all("--hash=sha256:" in (ROOT / file).read_text(encoding="utf-8") for file in files)
    assert {"--no-deps", "--no-build-isolation", "."} == set(project.split())


def test_what_is_copied_is_let_in() -> None:
    let_in = re.findall(r"^!(.+)$", (ROOT / ".dockerignore").read_text(encoding="utf-8"), flags=re.MULTILINE)
    copied = re.findall(r"^COPY (?!--from)(.*) \S+$", DOCKERFILE, flags=re.MULTILINE)
    assert {name for names in copied for name in names.split()} == set(let_in)
