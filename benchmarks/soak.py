"""Many short navigation sessions, and what the service's processes hold before and after them.

    .venv/bin/python benchmarks/soak.py --sessions 20000

renders the demo's walks, has a service build the leader's map, and lets followers come and go: half of them
say goodbye, half vanish. Linux only: memory and handles are read from /proc.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from websockets.asyncio.client import connect

from server.protocol.frames import Frame, encode_frame
from server.protocol.messages import Goodbye, UpdateMessage, Welcome, parse_server_message

_ANSWER_TIMEOUT_S = 60.0

Message = TypeVar("Message", Welcome, UpdateMessage, Goodbye)


@dataclass(frozen=True, slots=True)
class Footprint:
    """What a process and all its descendants hold.

    Attributes:
        rss_mb: resident memory, shared pages counted in each process.
        files: open file handles; processes, threads: their numbers.
        cpu_s: processor time used so far.
    """

    rss_mb: float
    files: int
    processes: int
    threads: int
    cpu_s: float


def footprint(pid: int) -> Footprint:
    """Of a service by its process id."""
    pids, found = [pid], []
    while pids:
        found.append(pids.pop())
        for task in Path(f"/proc/{found[-1]}/task").iterdir():
            pids += map(int, (task / "children").read_text().split())
    rss_kb = threads = files = ticks = 0
    for each in found:
        status = dict(
            line.split(":", 1)
            for line in Path(f"/proc/{each}/status").read_text().splitlines()
            if ":" in line
        )
        rss_kb += int(status["VmRSS"].split()[0])
        threads += int(status["Threads"])
        files += len(list(Path(f"/proc/{each}/fd").iterdir()))
        times = Path(f"/proc/{each}/stat").read_text().rpartition(")")[2].split()
        ticks += int(times[11]) + int(times[12])
    return Footprint(rss_kb / 1024, files, len(found), threads, ticks / os.sysconf("SC_CLK_TCK"))


@dataclass(frozen=True, slots=True)
class Visit:
    """Where followers go, and what they show.

    Attributes:
        url: of the service, ``http://…``.
        camera: JSON of the pictures' camera; pictures: JPEG.
    """

    url: str
    route_id: str
    camera: dict[str, Any]
    pictures: Sequence[bytes]


async def come_and_go(visit: Visit, number: int, *, politely: bool) -> int:
    """One session: greeted, two pictures answered, left. Returns how many pictures were located."""
    url = f"{visit.url.replace('http', 'ws', 1)}/v1/routes/{visit.route_id}/navigate"
    located = 0
    async with asyncio.timeout(_ANSWER_TIMEOUT_S), connect(url, proxy=None) as socket:
        hello = {"type": "hello", "protocol": 1, "camera": visit.camera, "clock_us": 0}
        await socket.send(json.dumps(hello))
        _expect(await socket.recv(), Welcome)
        for sequence in (1, 2):
            picture = visit.pictures[(2 * number + sequence) % len(visit.pictures)]
            await socket.send(encode_frame(Frame(sequence, sequence * 100_000, picture)))
            located += _expect(await socket.recv(), UpdateMessage).fix is not None
        if politely:
            await socket.send('{"type": "end"}')
            _expect(await socket.recv(), Goodbye)
        else:
            socket.transport.abort()
    return located


def _expect(text: str | bytes, kind: type[Message]) -> Message:
    message = parse_server_message(text)
    if not isinstance(message, kind):
        raise RuntimeError(f"a {kind.__name__} was due, this came: {message}")
    return message


async def crowd(visit: Visit, sessions: int, at_once: int) -> int:
    """So many sessions, some at once; returns how many pictures were located."""
    numbers = iter(range(sessions))

    async def followers() -> int:
        return sum([await come_and_go(visit, n, politely=n % 2 == 0) for n in numbers])

    return sum(await asyncio.gather(*(followers() for _ in range(at_once))))


def _only_child() -> int:
    children = [
        int(child)
        for task in Path("/proc/self/task").iterdir()
        for child in (task / "children").read_text().split()
    ]
    (pid,) = children
    return pid


async def _main(sessions: int, at_once: int, every: int) -> None:
    import cv2

    from client_sim.demo import child_service
    from client_sim.leader import LeaderOptions, lead
    from client_sim.service import ServiceClient
    from client_sim.synthetic.demo import write_demo_walks
    from client_sim.walk import Walk

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        walks = await asyncio.to_thread(write_demo_walks, folder / "walks")
        leader, follower = (Walk.from_folder(walk) for walk in walks)
        async with (
            child_service(folder / "data", folder / "service.log") as url,
            ServiceClient(url) as service,
        ):
            route = await lead(service, leader, LeaderOptions())
            camera = json.loads((walks[1] / "camera.json").read_text(encoding="utf-8"))
            video, pictures = cv2.VideoCapture(str(follower.video)), []
            while (taken := video.read())[0]:
                pictures.append(cv2.imencode(".jpg", taken[1])[1].tobytes())
            visit = Visit(url, route.id, camera, pictures)
            pid = _only_child()
            print("sessions  located   RSS MB  files  processes  threads  CPU s")
            for done in range(0, sessions + 1, every):
                located = await crowd(visit, every, at_once) if done else 0
                now = footprint(pid)
                print(
                    f"{done:8d} {located:8d} {now.rss_mb:8.1f} {now.files:6d} {now.processes:10d} "
                    f"{now.threads:8d} {now.cpu_s:6.1f}",
                    flush=True,
                )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sessions", type=int, default=20_000)
    parser.add_argument("--at-once", type=int, default=16)
    parser.add_argument("--every", type=int, default=500, help="sessions between two measurements")
    given = parser.parse_args()
    asyncio.run(_main(given.sessions, given.at_once, given.every))
