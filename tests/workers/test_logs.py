from __future__ import annotations

import subprocess
import sys

import pytest

CHATTY = ["alembic.runtime.migration", "faiss.loader", "httpx", "uvicorn.error"]


@pytest.mark.parametrize("name", CHATTY)
def test_libraries_only_warn(name: str) -> None:
    program = (
        "import logging\n"
        "from server.workers.logs import configure_logs\n"
        "configure_logs(as_json=True)\n"
        f"logging.getLogger({name!r}).info('started')\n"
        f"logging.getLogger({name!r}).warning('beware')\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "beware" in done.stderr
    assert "started" not in done.stderr
