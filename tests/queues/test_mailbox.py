from __future__ import annotations

import asyncio

import pytest

from server.queues.mailbox import Mailbox, MailboxClosed


async def test_the_newest_wins_and_the_replaced_one_is_told() -> None:
    mailbox: Mailbox[int] = Mailbox()
    assert [mailbox.put(n) for n in (1, 2, 3)] == [None, 1, 2]
    assert await mailbox.take() == 3
    assert mailbox.put(4) is None
    assert await mailbox.take() == 4


async def test_taking_waits() -> None:
    mailbox: Mailbox[str] = Mailbox()
    taking = asyncio.create_task(mailbox.take())
    await asyncio.sleep(0.01)
    assert not taking.done()
    mailbox.put("here")
    assert await taking == "here"


async def test_a_cancelled_taker_loses_nothing() -> None:
    mailbox: Mailbox[str] = Mailbox()
    taking = asyncio.create_task(mailbox.take())
    await asyncio.sleep(0)
    mailbox.put("here")
    taking.cancel()
    with pytest.raises(asyncio.CancelledError):
        await taking
    assert await mailbox.take() == "here"


async def test_closing_lets_the_taker_go_and_takes_nothing_more() -> None:
    mailbox: Mailbox[int] = Mailbox()
    taking = asyncio.create_task(mailbox.take())
    await asyncio.sleep(0)
    mailbox.close()
    with pytest.raises(MailboxClosed):
        await taking
    with pytest.raises(MailboxClosed):
        mailbox.put(1)
