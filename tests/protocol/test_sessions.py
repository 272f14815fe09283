"""The example sessions, played against the real service on the demo's route."""

from __future__ import annotations

import base64
from collections.abc import AsyncIterator, Callable

import pytest
import pytest_asyncio
import session_script
from demo_route import DemoRoute
from demo_service import DemoService, serving
from session_script import Phone, SessionScript

from server.protocol.frames import FrameHeaderError, decode_frame

pytestmark = pytest.mark.asyncio(loop_scope="module")

SCRIPTS = session_script.scripts()
QUICK = [script for script in SCRIPTS if not script.settings]
PARTICULAR = [script for script in SCRIPTS if script.settings]


@pytest_asyncio.fixture(loop_scope="module", scope="module")
async def demo(demo_route: DemoRoute, tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[DemoService]:
    async with serving(demo_route, tmp_path_factory.mktemp("sessions")) as running:
        yield running


@pytest.mark.parametrize("script", QUICK, ids=lambda script: script.name)
async def test_the_service_keeps_to_the_session(
    demo: DemoService, follower_jpeg: Callable[[int | None], bytes], script: SessionScript
) -> None:
    await Phone(demo.service.url, demo.route_id, follower_jpeg).play(script)


@pytest.mark.parametrize("script", PARTICULAR, ids=lambda script: script.name)
async def test_the_service_keeps_to_the_session_with_settings_of_its_own(
    demo_route: DemoRoute,
    tmp_path_factory: pytest.TempPathFactory,
    follower_jpeg: Callable[[int | None], bytes],
    script: SessionScript,
) -> None:
    async with serving(demo_route, tmp_path_factory.mktemp(script.name), **script.settings) as demo:
        await Phone(demo.service.url, demo.route_id, follower_jpeg).play(script)


async def test_a_session_that_the_service_does_not_keep_to_is_noticed(
    demo: DemoService, follower_jpeg: Callable[[int | None], bytes]
) -> None:
    normal = next(script for script in SCRIPTS if script.name == "normal")
    for index, change in ((2, {"resumed": True}), (2, {"more": 1}), (4, {"id": "$string"})):
        steps = list(normal.steps)
        steps[index] = {**steps[index], "pattern": {**steps[index]["pattern"], **change}}
        changed = SessionScript("changed", "", "", {}, tuple(steps))
        with pytest.raises(AssertionError, match=f"changed.jsonl:{index + 2}"):
            await Phone(demo.service.url, demo.route_id, follower_jpeg).play(changed)


async def test_the_sessions_cover_what_a_phone_meets() -> None:
    names = {script.name for script in SCRIPTS}
    assert {
        "normal",
        "refusal-and-recovery",
        "version-mismatch",
        "bad-hello",
        "resume",
        "wrong-order",
    } <= names
    assert {"too-large", "newest-wins", "bad-pictures", "ping-and-silence", "slow-reader"} <= names
    steps = [step for script in SCRIPTS for step in script.steps]
    closes = {step["code"] for step in steps if step["kind"] == "close"}
    assert {1000, 4400, 4406, 4408, 4413, 4415, 4422} <= closes
    types = {step["pattern"]["type"] for step in steps if "pattern" in step}
    assert types == {"welcome", "update", "error", "pong", "goodbye"}


async def test_binary_messages_of_the_sessions_are_whole_but_those_that_are_meant_to_be_broken() -> None:
    broken = []
    for script in SCRIPTS:
        for step in script.steps:
            if step["kind"] == "binary" and step.get("count", 1) == 1:
                try:
                    decode_frame(base64.b64decode(step["base64"]))
                except FrameHeaderError as error:
                    broken.append((script.name, str(error)))
    assert [name for name, _ in broken] == ["bad-pictures", "version-mismatch"]


async def test_a_session_is_shown_line_by_line() -> None:
    for script in SCRIPTS:
        lines = session_script.shown(script)
        assert len(lines) == len(script.steps)
        assert all(line.rpartition("\n")[2].startswith(("→ ", "← ")) for line in lines)
