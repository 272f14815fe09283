"""The tutorials work as they are written: their programs run, their commands exist."""

from __future__ import annotations

import asyncio
import os
import re
import shlex
import shutil
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import click
import pytest
import pytest_asyncio
import typer
from demo_route import DemoRoute
from demo_service import DemoService, serving
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from server.cli import app

pytestmark = pytest.mark.asyncio(loop_scope="module")

ROOT = Path(__file__).parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
CODE = re.compile(r"```sh\n.*?```|`make [^`\n]*`", re.DOTALL)
ALONE = {**os.environ, "NO_PROXY": "127.0.0.1", "no_proxy": "127.0.0.1"}


def blocks(page: str, language: str) -> list[str]:
    """Code of a tutorial."""
    text = (TUTORIALS / page).read_text(encoding="utf-8")
    return re.findall(rf"```{language}\n(.*?)```", text, flags=re.DOTALL)


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def demo(demo_route: DemoRoute, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[DemoService]:
    async with serving(demo_route, tmp_path_factory.mktemp("tutorials"), max_video_bytes=1 << 30) as running:
        yield running


def cut_connections(demo: DemoService) -> int:
    """As a network does: no closing handshake. Returns how many sockets there were."""
    sockets = [
        connection
        for connection in demo.service.server.server_state.connections
        if isinstance(connection, WebSocketsSansIOProtocol)
    ]
    for socket in sockets:
        socket.transport.abort()
    return len(sockets)


async def test_the_phone_of_the_tutorial_arrives_over_a_connection_that_breaks(
    demo: DemoService, demo_route: DemoRoute, tmp_path: Path
) -> None:
    program = tmp_path / "follower.py"
    program.write_text("\n\n".join(blocks("phone-developer.md", "python")), encoding="utf-8")
    walk = demo_route.follower.folder
    phone = await asyncio.create_subprocess_exec(
        sys.executable,
        "-W",
        "error",
        "-u",
        program,
        demo.service.url,
        demo.route_id,
        walk / "video.mp4",
        walk / "camera.json",
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env=ALONE,
    )
    assert phone.stdout is not None
    assert phone.stderr is not None
    said: list[str] = []
    async with asyncio.timeout(90):
        async for line in phone.stdout:
            said.append(line.decode().rstrip())
            if len([s for s in said if s.startswith("Go straight")]) == 1 and "(no connection)" not in said:
                assert cut_connections(demo) == 1
        errors = (await phone.stderr.read()).decode()
        assert await phone.wait() == 0, errors
    assert said[0] == "To the lab: from Door to Lab"
    assert said.count("(no connection)") == 1
    assert said[-1] == "You have arrived."
    turns = [s for s in said if s.startswith("Turn")]
    assert turns[0] == "Turn left.", said
    assert "Turn right." in turns[1:]
    assert errors == ""


async def test_a_phone_without_a_route_is_told_so(demo: DemoService, tmp_path: Path) -> None:
    program = tmp_path / "follower.py"
    program.write_text("\n\n".join(blocks("phone-developer.md", "python")), encoding="utf-8")
    nowhere = demo.route_id[:-4] + "0000"
    phone = await asyncio.create_subprocess_exec(
        sys.executable,
        program,
        demo.service.url,
        nowhere,
        "none.mp4",
        "none.json",
        stderr=asyncio.subprocess.PIPE,
        env=ALONE,
    )
    _, errors = await phone.communicate()
    assert phone.returncode == 1
    assert errors.decode().strip() == f"there is no route {nowhere}"


async def test_the_shop_owners_commands_upload_look_and_delete(
    demo: DemoService, demo_route: DemoRoute, tmp_path: Path
) -> None:
    """As they stand, in their order; the service takes the finished map for the video."""
    (tmp_path / "walk").mkdir()
    shutil.copyfile(demo_route.leader.folder / "camera.json", tmp_path / "walk" / "camera.json")
    (tmp_path / "walk" / "video.mp4").write_text(str(demo_route.map_file), encoding="utf-8")
    commands = [
        block.replace(".venv/bin/pairnavi", f"{shlex.quote(sys.executable)} -m server.cli")
        for block in blocks("shop-owner.md", "sh")
    ]
    assert len(commands) == 5
    commands.insert(
        2, 'until curl -fsS "$SERVER/v1/routes/$ROUTE" | grep -q \'"ready"\'; do sleep 0.1; done\n'
    )
    script = "set -euo pipefail\n" + "echo; echo ---\n".join(commands)
    shell = await asyncio.create_subprocess_exec(
        "bash",
        "-c",
        script,
        cwd=tmp_path,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**ALONE, "SERVER": demo.service.url, "PYTHONPATH": str(ROOT)},
    )
    async with asyncio.timeout(60):
        out, errors = await shell.communicate()
    assert shell.returncode == 0, errors.decode()
    led, uploaded, _, looked, judged, deleted = out.decode().split("---")
    assert re.fullmatch(r"[0-9a-f-]{36}", led.strip())
    assert '"state":"uploaded"' in uploaded
    assert '"measured_length_m":41.5' in looked
    assert '"state":"ready"' in looked
    assert '"record_again":false' in judged
    assert deleted.strip() == ""
    left = (await demo.service.http.get("/v1/routes")).json()["routes"]
    assert {route["id"] for route in left} == {demo.route_id, led.strip()}


def commands_of_the_pages() -> list[tuple[str, str]]:
    """Every call of the command in the pages, with the page's name."""
    found = []
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = page.read_text(encoding="utf-8")
        for block in re.findall(r"```sh\n(.*?)```", text, flags=re.DOTALL):
            for line in block.replace("\\\n", " ").splitlines():
                call = re.match(r"^(?:[A-Z_]+=\S+ )*(?:\.venv/bin/)?pairnavi (.*)$", line.strip())
                if call:
                    found.append((page.name, call[1].partition("#")[0].strip()))
    return found


@pytest.mark.parametrize(("page", "call"), commands_of_the_pages())
async def test_commands_of_the_pages_are_understood(page: str, call: str) -> None:
    command: click.Command = typer.main.get_command(app)
    words = shlex.split(call.replace("…", "x"))
    context = click.Context(command)
    while isinstance(command, click.Group):
        name = words.pop(0)
        found = command.get_command(context, name)
        assert found is not None, f"{page}: there is no command {name!r}"
        command = found
    if command.name != "evaluate":
        command.make_context(command.name, words)


async def test_targets_of_make_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")]
    code = "".join("".join(CODE.findall(page.read_text(encoding="utf-8"))) for page in pages)
    targets = set(re.findall(r"\bmake ([a-z-]+)", code))
    assert {"demo", "test", "spec", "install"} <= targets
    for target in targets:
        assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target


async def test_the_backup_of_the_tutorial_is_whole(tmp_path: Path) -> None:
    import sqlite3

    (tmp_path / "var" / "store").mkdir(parents=True)
    (tmp_path / "var" / "store" / "file").write_text("x")
    with sqlite3.connect(tmp_path / "var" / "pairnavi.db") as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("CREATE TABLE routes (id)")
        database.execute("INSERT INTO routes VALUES (1)")
        database.commit()
        backup = next(block for block in blocks("operator.md", "sh") if "backup" in block)
        shell = await asyncio.create_subprocess_exec("bash", "-ec", backup, cwd=tmp_path)
        assert await shell.wait() == 0
    database.close()
    copy = sqlite3.connect(tmp_path / "backup.db")
    assert copy.execute("SELECT id FROM routes").fetchall() == [(1,)]
    copy.close()
    assert (tmp_path / "backup-store" / "file").is_file()
