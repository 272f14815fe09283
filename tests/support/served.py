"""A real service in a process of its own, which tests may kill."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

LISTENING = "listening on "


@dataclass(frozen=True, slots=True)
class Served:
    """A running service: its URL, its process, and where its log goes."""

    url: str
    process: subprocess.Popen[str]
    log: Path


@contextmanager
def served(data: Path, builder: str, engine: str, **settings: object) -> Iterator[Served]:
    """Start a service, kill it afterwards if it is still there.

    Args:
        builder, engine: what its child processes run, import paths as in :class:`Entries`.
        settings: of :class:`server.settings.Settings`.
    """
    root = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(root), str(Path(__file__).parent)])}
    for name, value in settings.items():
        environment[f"PAIRNAVI_{name.upper()}"] = str(value)
    data.mkdir(parents=True, exist_ok=True)
    log = data / "service.log"
    with (
        log.open("a") as errors,
        subprocess.Popen(
            [sys.executable, __file__, str(data), builder, engine],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env=environment,
            cwd=root,
        ) as process,
    ):
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert line.startswith(LISTENING), log.read_text()
            yield Served(line.removeprefix(LISTENING).strip(), process, log)
        finally:
            process.kill()


def _main(data: str, builder: str, engine: str) -> None:
    from server.api.components import Entries
    from server.api.serving import build_server, listen
    from server.settings import Settings
    from server.workers.logs import configure_logs

    configure_logs(as_json=True)
    settings = Settings(data_dir=Path(data), port=0)
    server = build_server(
        settings, Entries(builder, engine), lambda url: print(f"{LISTENING}{url}", flush=True)
    )
    server.run(sockets=[listen(settings.host, settings.port)])


if __name__ == "__main__":
    _main(*sys.argv[1:])
