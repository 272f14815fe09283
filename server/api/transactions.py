"""The transaction of a request: it ends, and its after-commit actions run, before the answer is sent."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated

from fastapi import Depends

from server.api.components import Parts
from server.storage.database import UnitOfWork


async def unit_of_work(parts: Parts) -> AsyncIterator[UnitOfWork]:
    """A unit of work, committed when the endpoint returns and rolled back when it raises."""
    async with parts.database.begin() as unit:
        yield unit


Unit = Annotated[UnitOfWork, Depends(unit_of_work, scope="function")]
