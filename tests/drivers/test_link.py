"""The supervisor alone, over connections that are plain numbers."""

import asyncio
import random
from collections.abc import AsyncIterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import LinkDown
from drivers.link import Backoff, DeadPeer, Link
from drivers.modbus.settings import ModbusSettings


class Wires:
    """A peer: while `up`, each connection is the next number."""

    def __init__(self) -> None:
        self.up = True
        self.hangs = False
        self.attempts: list[float] = []
        self.made = 0
        self.dropped: list[int] = []

    async def connect(self) -> int:
        self.attempts.append(asyncio.get_running_loop().time())
        if self.hangs:
            await asyncio.sleep(3600)
        if not self.up:
            raise LinkDown("refused")
        self.made += 1
        return self.made

    def link(self, **changes: float) -> Link[int]:
        return Link(
            self.connect,
            self.dropped.append,
            connect_deadline=0.1,
            backoff=Backoff(changes.get("first", 0.02), changes.get("cap", 0.08)),
            dead_peer=DeadPeer(3, 2.0),
            seed=1,
        )


@pytest.fixture
async def wires() -> AsyncIterator[Wires]:
    yield Wires()


@settings(max_examples=50)
@given(failures=st.integers(1, 10_000), seed=st.integers(0, 99))
def test_the_pause_doubles_up_to_the_cap_within_the_jitter(failures: int, seed: int) -> None:
    backoff = Backoff(0.2, 5.0, 0.2)
    plain = min(5.0, 0.2 * 2 ** min(failures - 1, 10))
    assert 0.8 * plain <= backoff.delay(failures, random.Random(seed)) <= min(1.2 * plain, backoff.longest)


def test_the_default_pause_and_one_connect_deadline_are_together_under_a_second() -> None:
    given = ModbusSettings(host="plc")
    backoff = Backoff(given.backoff_first, given.backoff_cap)
    assert backoff == Backoff()
    assert backoff.longest + given.connect_timeout < 1.0


async def test_the_same_seed_gives_the_same_pauses() -> None:
    one, other = random.Random(7), random.Random(7)
    assert [Backoff().delay(n, one) for n in range(1, 9)] == [Backoff().delay(n, other) for n in range(1, 9)]


async def test_open_raises_the_reason_and_the_link_goes_on_trying(wires: Wires) -> None:
    wires.up = False
    link = wires.link()
    with pytest.raises(LinkDown, match="refused"):
        await link.open()
    await asyncio.sleep(0.1)
    wires.up = True
    await asyncio.sleep(0.15)
    assert link.connection == 1
    await link.close()
    assert wires.dropped == [1]


async def test_a_connect_that_hangs_ends_at_its_deadline(wires: Wires) -> None:
    wires.hangs = True
    link = wires.link()
    with pytest.raises(LinkDown, match=r"no connection within 0\.1 s"):
        await link.open()
    await link.close()


async def test_close_ends_a_hanging_attempt_and_may_be_called_twice_or_first(wires: Wires) -> None:
    wires.hangs = True
    link = wires.link()
    await link.close()
    opening = asyncio.ensure_future(link.open())
    await asyncio.sleep(0.01)
    await link.close()
    await link.close()
    with pytest.raises(LinkDown):
        await opening


async def test_a_closed_link_can_be_opened_again(wires: Wires) -> None:
    link = wires.link()
    await link.open()
    await link.close()
    assert link.connection is None
    await link.open()
    assert link.connection == 2
    await link.close()


async def test_three_failed_exchanges_in_a_row_end_the_connection_and_it_is_reopened_at_once(wires: Wires) -> None:
    link = wires.link(first=30, cap=30)
    await link.open()
    link.note_answer(1)
    for _ in range(2):
        link.failed(1, 0.1, "no reply")
    link.note_answer(1)
    for _ in range(3):
        assert link.connection == 1
        link.failed(1, 0.1, "no reply")
    assert link.connection is None
    assert "3 exchanges in a row" in link.reason
    await asyncio.sleep(0.05)
    assert link.connection == 2
    await link.close()


async def test_two_seconds_of_waiting_end_the_connection_however_few_the_exchanges(wires: Wires) -> None:
    link = wires.link()
    await link.open()
    assert link.patience(5.0) == 2.0
    link.failed(1, 1.5, "no reply")
    assert link.patience(5.0) == 0.5
    assert link.connection == 1
    link.failed(1, 0.5, "no reply")
    assert link.connection is None
    await link.close()


async def test_a_peer_that_accepts_and_never_answers_is_called_with_growing_pauses(wires: Wires) -> None:
    link = wires.link(first=0.1, cap=0.4)
    await link.open()
    end = asyncio.get_running_loop().time() + 0.9
    while asyncio.get_running_loop().time() < end:
        if link.connection is not None:
            link.lost(link.connection, "closed")
        await asyncio.sleep(0.005)
    assert 3 <= len(wires.attempts) <= 6
    await link.close()


async def test_wake_tries_at_once(wires: Wires) -> None:
    wires.up = False
    link = wires.link(first=30, cap=30)
    with pytest.raises(LinkDown):
        await link.open()
    await asyncio.sleep(0.01)
    wires.up = True
    link.wake()
    await asyncio.sleep(0.02)
    assert link.connection == 1
    await link.close()


async def test_reports_about_a_replaced_connection_are_ignored(wires: Wires) -> None:
    link = wires.link()
    await link.open()
    link.note_answer(1)
    link.lost(1, "reset")
    await asyncio.sleep(0.05)
    assert link.connection == 2
    for _ in range(5):
        link.failed(1, 1.0, "late")
    link.lost(1, "late")
    link.note_answer(1)
    assert link.connection == 2
    assert not link.proven
    await link.close()


async def test_only_a_valid_reply_proves_the_peer(wires: Wires) -> None:
    link = wires.link()
    await link.open()
    assert not link.proven
    link.note_answer(1)
    assert link.proven
    link.lost(1, "reset")
    assert not link.proven
    await link.close()
