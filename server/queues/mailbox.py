"""A mailbox for one letter: the newest wins."""

from __future__ import annotations

import asyncio
from typing import Generic, TypeVar

T = TypeVar("T")


class MailboxClosed(Exception):  # noqa: N818 - the end of a stream, as StopIteration
    """Nothing more will come."""


class Mailbox(Generic[T]):
    """Holds at most one item; a new one replaces one that was not taken.

    For pictures: an old one is worth nothing once there is a newer. One event loop, one taker.
    """

    def __init__(self) -> None:
        self._item: T | None = None
        self._closed = False
        self._arrived = asyncio.Event()

    def put(self, item: T) -> T | None:
        """Place an item; returns the one it replaces, or None.

        Raises:
            MailboxClosed: the mailbox takes nothing more.
        """
        if self._closed:
            raise MailboxClosed
        replaced, self._item = self._item, item
        self._arrived.set()
        return replaced

    async def take(self) -> T:
        """The item, as soon as there is one.

        Raises:
            MailboxClosed: it was closed; an item still in it is lost.
        """
        await self._arrived.wait()
        if self._closed or self._item is None:
            raise MailboxClosed
        item, self._item = self._item, None
        self._arrived.clear()
        return item

    def close(self) -> None:
        """Take nothing more and let the taker go."""
        self._closed = True
        self._arrived.set()
