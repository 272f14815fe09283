"""Settings of a deployment, from the environment (``PAIRNAVI_*``) or the command line.

Only the app factory, the workers' start and the command line read them; everything else is handed
small option objects.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field
from pydantic_settings import BaseSettings, NoDecode, SettingsConfigDict

from server.navigation.frames import MAX_PIXELS

_ANY_ADDRESS = ("0.0.0.0", "::", "")  # noqa: S104 - compared with, not listened on


def _split(value: Any) -> Any:
    return [part.strip() for part in value.split(",") if part.strip()] if isinstance(value, str) else value


HostName = Annotated[str, Field(pattern=re.compile(r"^(\[[0-9A-Fa-f:.]+\]|[^\s:/?#@*\[\]]+)$"))]


class Settings(BaseSettings):
    """Sizes in bytes, times in seconds.

    Attributes:
        host: address to listen on; loopback by default.
        port: 0 takes a free one.
        allowed_hosts: names and addresses under which the service is reached, without ports; in the
            environment separated by commas. Requests for others are refused. An address in ``host`` is
            allowed too.
        data_dir: folder of the database file and the object store.
        database_url: SQLAlchemy URL with an async driver; by default SQLite in ``data_dir``.
        max_video_bytes: of one upload.
        build_processes: builds that run at once.
        build_timeout_s: after which a build is given up.
        build_memory_bytes: that a build may take; on Linux only.
        max_build_attempts: builds begun for one upload before a restart of the service gives it up.
        navigation_processes: processes that own sessions.
        maps_per_process: route maps kept open in each of them.
        max_sessions: navigation sessions at once, connected or waiting to be resumed.
        max_frame_bytes, max_pixels: of one picture.
        max_message_bytes: of one JSON message or document.
        max_frames_per_second, max_messages_per_second: sustained; bursts of four seconds' worth pass.
        heartbeat_interval_s: how often clients are told to ping.
        idle_timeout_s: silence after which a connection is closed.
        hello_timeout_s: for the first message.
        head_timeout_s: for a request's line and headers, from the connection or the last answer on.
        body_timeout_s: for the next piece of a request's body.
        send_timeout_s: for a message to be taken by the client's network.
        resume_within_s: how long a session outlives its connection.
        log_json: structured lines for machines instead of coloured ones for people.
    """

    model_config = SettingsConfigDict(env_prefix="PAIRNAVI_", extra="ignore", frozen=True)

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    allowed_hosts: Annotated[tuple[HostName, ...], NoDecode, BeforeValidator(_split)] = (
        "127.0.0.1",
        "localhost",
        "[::1]",
    )
    data_dir: Path = Path("var")
    database_url: str | None = None

    max_video_bytes: int = Field(default=4 << 30, gt=0)
    build_processes: int = Field(default=1, ge=1)
    build_timeout_s: float = Field(default=7200.0, gt=0)
    build_memory_bytes: int = Field(default=8 << 30, ge=1 << 30)
    max_build_attempts: int = Field(default=3, ge=1)

    navigation_processes: int = Field(default=1, ge=1)
    maps_per_process: int = Field(default=4, ge=1)
    max_sessions: int = Field(default=64, ge=1)
    max_frame_bytes: int = Field(default=2 << 20, gt=0)
    max_pixels: int = Field(default=MAX_PIXELS, gt=0)
    max_message_bytes: int = Field(default=64 << 10, gt=0)
    max_frames_per_second: float = Field(default=30.0, gt=0)
    max_messages_per_second: float = Field(default=10.0, gt=0)
    heartbeat_interval_s: float = Field(default=5.0, gt=0)
    idle_timeout_s: float = Field(default=20.0, gt=0)
    hello_timeout_s: float = Field(default=10.0, gt=0)
    head_timeout_s: float = Field(default=15.0, gt=0)
    body_timeout_s: float = Field(default=60.0, gt=0)
    send_timeout_s: float = Field(default=5.0, gt=0)
    resume_within_s: float = Field(default=120.0, gt=0)

    log_json: bool = False

    @property
    def host_names(self) -> frozenset[str]:
        """What a request's host may be, in lower case, without ports."""
        names = {name.lower() for name in self.allowed_hosts}
        if self.host not in _ANY_ADDRESS:
            names.add(f"[{self.host}]".lower() if ":" in self.host else self.host.lower())
        return frozenset(names)

    @property
    def resolved_database_url(self) -> str:
        """The database's URL, the default filled in."""
        if self.database_url is not None:
            return self.database_url
        return f"sqlite+aiosqlite:///{self.data_dir.resolve() / 'pairnavi.db'}"
