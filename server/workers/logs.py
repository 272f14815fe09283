"""Structured logs on standard error. Tokens never reach them: sessions are named by their ids."""

from __future__ import annotations

import logging
import sys

import structlog

_as_json = False


def logs_are_json() -> bool:
    """What :func:`configure_logs` was last told: children of this process log alike."""
    return _as_json


def configure_logs(*, as_json: bool) -> None:
    """Send structlog's and the libraries' logs to standard error, in one format."""
    global _as_json
    _as_json = as_json
    shared: list[structlog.typing.Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.format_exc_info,
    ]
    renderer: structlog.typing.Processor = (
        structlog.processors.JSONRenderer()
        if as_json
        else structlog.dev.ConsoleRenderer(colors=sys.stderr.isatty())
    )
    structlog.configure(
        processors=[*shared, structlog.stdlib.ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.make_filtering_bound_logger(logging.INFO),
        cache_logger_on_first_use=True,
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
        )
    )
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(logging.INFO)
    # They log every socket with its path and query; the service's own lines say what matters.
    logging.getLogger("uvicorn.error").setLevel(logging.WARNING)
    logging.getLogger("httpx").setLevel(logging.WARNING)
    # They tell at every start how they were built and which database they look at.
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("faiss").setLevel(logging.WARNING)
