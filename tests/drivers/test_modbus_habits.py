"""Habits of real devices: each is read good, or named in one sentence with the setting that reads it."""

import asyncio
import os
import pty
import random
import re
import struct
import tty
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from drivers.device_file import DeviceFile, TagTable
from drivers.errors import DeviceException, LinkDown, NotAsked, ReplyTimeout, WriteUnverified
from drivers.modbus import rtu
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.survey import open_survey
from drivers.tag import DType, Quality, Tag
from tests.drivers.certified import folder as certificates
from tests.drivers.certified import server_context
from tests.rig.device_habits import HABITS, LINE, PAGE, PTY, TCP, TLS, DeviceHabit, page

TAGS = [Tag(f"T{number}", f"holding:{number}", DType.INT16, writable=True) for number in range(8)]
SOON = {"timeout": 0.15, "backoff_first": 0.01, "backoff_cap": 0.02}
"""Short waits; a machine that is loaded makes them longer, which costs the tests nothing but time."""


@dataclass
class Habit:
    """A device with one habit or several: registers 0 to 7 hold their own numbers."""

    quiet: float = 0.0
    silent_at: int = -1
    busy: int = 0
    stale: int = 0
    transaction: int | None = None
    unit: int | None = None
    lead: bytes = b""
    late: float = 0.0
    echo: bool = False
    hidden: bool = False
    single: bool = False
    ends_connections: bool = False
    even: bool = False
    most: int = 125
    serial: bool = False
    registers: dict[int, int] = field(default_factory=lambda: {number: number for number in range(8)})
    requests: list[tuple[int, int, int]] = field(default_factory=list)
    _former: list[dict[int, int]] = field(default_factory=list)
    _asked: Any = field(default_factory=count)

    def answer(self, pdu: bytes) -> bytes | None:
        function, start, number = struct.unpack(">BHH", pdu[:5])
        self.requests.append((function, start, number))
        if self.busy and next(self._asked) % 3 < self.busy:
            return bytes((function | 0x80, 6))
        if function == 16 and self.single:
            return bytes((16 | 0x80, 1))
        if function == 6:
            self._former = [dict(self.registers)] * self.stale
            self.registers[start] = number
            return pdu[:5]
        if function == 3 and (number > self.most or (self.even and (start % 2 or number % 2))):
            return bytes((3 | 0x80, 3))
        if function == 3 and start <= self.silent_at < start + number:
            return None
        if function == 16:
            self._former = [dict(self.registers)] * self.stale
            self.registers |= dict(
                zip(range(start, start + number), struct.unpack(f">{number}H", pdu[6:]), strict=True)
            )
            return pdu[:5]
        shown = self._former.pop() if self._former else self.registers
        if self.hidden:
            shown = {number: number for number in range(8)}
        return struct.pack(f">BB{number}H", function, 2 * number, *(shown[at] for at in range(start, start + number)))

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        born = asyncio.get_running_loop().time()
        try:
            while True:
                head = await reader.readexactly(1 if self.serial else 7)
                size = 7 if self.serial else int.from_bytes(head[4:6], "big") - 1
                request = await reader.readexactly(size)
                if self.serial and request[0] == 16:
                    request += await reader.readexactly(request[5] + 1)
                if self.echo:
                    writer.write(head + request)
                pdu = self.answer(request[:-2] if self.serial else request)
                if pdu is None or asyncio.get_running_loop().time() < born + self.quiet:
                    continue
                await asyncio.sleep(self.late)
                unit = bytes((head[-1] if self.unit is None else self.unit,))
                if self.serial:
                    writer.write(self.lead + unit + pdu + rtu.crc(unit + pdu))
                    continue
                number = head[:2] if self.transaction is None else self.transaction.to_bytes(2, "big")
                writer.write(number + b"\0\0" + (len(pdu) + 1).to_bytes(2, "big") + unit + pdu)
                if self.ends_connections:
                    writer.close()
                    return
        except (asyncio.IncompleteReadError, OSError, asyncio.CancelledError):
            writer.close()


@asynccontextmanager
async def served(habit: Habit, link: str = "", folder: Path = Path(), **settings: Any) -> AsyncIterator[dict[str, Any]]:
    """The settings of a driver for the device, over `link`; `folder` is for certificates."""
    link = link or (LINE if habit.serial else TCP)
    if link == PTY:
        async with on_a_pty(habit) as path:
            yield {"transport": PTY, "serial": path, **SOON, **settings}
        return
    context = server_context(folder / "server") if link == TLS else None
    server = await asyncio.start_server(habit.serve, "127.0.0.1", 0, ssl=context)
    own = {"certificates": str(certificates(folder / "client"))} if link == TLS else {}
    try:
        port = server.sockets[0].getsockname()[1]
        yield {"transport": link, "host": "127.0.0.1", "port": port, **SOON, **own, **settings}
    finally:
        server.close()


@asynccontextmanager
async def on_a_pty(habit: Habit) -> AsyncIterator[str]:
    """The device at the other end of a serial port, whose path it is."""
    loop, (near, far) = asyncio.get_running_loop(), pty.openpty()
    tty.setraw(far)
    reader = asyncio.StreamReader()
    receiving, _ = await loop.connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader),
        open(near, "rb", buffering=0, closefd=False),  # noqa: SIM115
    )
    sending, protocol = await loop.connect_write_pipe(
        asyncio.streams.FlowControlMixin,
        open(near, "wb", buffering=0, closefd=False),  # noqa: SIM115
    )
    writer = asyncio.StreamWriter(sending, protocol, reader, loop)
    task = asyncio.ensure_future(habit.serve(reader, writer))
    try:
        yield os.ttyname(far)
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
        receiving.close()
        await asyncio.sleep(0)
        os.close(near)
        os.close(far)


@asynccontextmanager
async def driven(habit: Habit, link: str = "", folder: Path = Path(), **settings: Any) -> AsyncIterator[ModbusDriver]:
    async with served(habit, link, folder, **settings) as given:
        driver = open_modbus(given, clock=asyncio.get_running_loop().time, write_map=TAGS)
        try:
            await driver.open()
            yield driver
        finally:
            await driver.close()


async def values(driver: ModbusDriver, done: Callable[[list[int | None]], bool]) -> list[int | None]:
    """Readings, asked for until they are as wanted; none that is good may be another register's."""
    async with asyncio.timeout(30):
        while True:
            samples = await driver.read(TAGS)
            found = [
                int(sample.value) if sample.quality.is_good and sample.value is not None else None for sample in samples
            ]
            assert all(value in (number, None) for number, value in enumerate(found))
            if done(found):
                return found
            await asyncio.sleep(0.01)


@pytest.mark.parametrize(
    ("habit", "settings"),
    [
        (Habit(quiet=1.0), {}),
        (Habit(quiet=0.5), {"pause_after_connect": 0.6}),
        (Habit(transaction=0), {"transaction_id": "any"}),
        (Habit(transaction=77, unit=0), {"transaction_id": "any", "answers_as": 0}),
        (Habit(unit=255), {"answers_as": 255}),
        (Habit(busy=2), {"timeout": 1.0}),
        (Habit(serial=True, lead=b"\0"), {}),
        (Habit(serial=True, lead=b"\0\xff\x55"), {}),
        (Habit(busy=1, transaction=0), {"transaction_id": "any", "timeout": 1.0}),
        (Habit(serial=True, lead=b"\0", busy=1), {"timeout": 1.0}),
        (Habit(quiet=0.4, busy=1), {"timeout": 1.0}),
    ],
    ids=str,
)
async def test_a_habit_is_read(habit: Habit, settings: dict[str, Any]) -> None:
    async with driven(habit, **settings) as driver:
        assert await values(driver, lambda found: None not in found) == list(range(8))


@pytest.mark.parametrize("place", [0, 5, 7])
async def test_silence_at_one_register_costs_that_register(place: int) -> None:
    async with driven(Habit(silent_at=place)) as driver:
        found = await values(driver, lambda found: found.count(None) == 1)
        assert found[place] is None
        assert f"holding:{place}" in (await driver.read(TAGS))[place].reason


async def test_silence_at_one_register_of_a_line_costs_that_register_too() -> None:
    async with driven(Habit(serial=True, silent_at=5), longest_reply=0.2) as driver:
        found = await values(driver, lambda found: found.count(None) == 1)
        assert found[5] is None


async def test_a_search_by_silence_takes_no_reading_longer_than_its_time() -> None:
    loop = asyncio.get_running_loop()
    async with driven(Habit(silent_at=5), timeout=0.3, attempts=1) as driver:
        while True:
            before, began = driver.statistics()["timeouts"], loop.time()
            samples = await driver.read(TAGS)
            # Two silent questions more than its time has room for: the one under way, and the one that found out.
            assert driver.statistics()["timeouts"] - before <= 3, f"{loop.time() - began:.2f} s"
            if sum(sample.quality.is_good for sample in samples) == 7:
                break


async def test_silence_is_found_by_hand_too() -> None:
    async with served(Habit(silent_at=5)) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        raws = await survey.tags(TAGS)
        assert [raw.sample.value for raw in raws] == [0, 1, 2, 3, 4, None, 6, 7]
        # As the gateway has it: the place waits in quarantine.
        assert raws[5].sample.quality is Quality.CONFIGURATION_ERROR and "no reply" in raws[5].sample.reason


async def test_a_late_read_back_is_waited_for_within_the_writes_time() -> None:
    habit = Habit(stale=2)
    async with driven(habit, timeout=1.0) as driver:
        await values(driver, lambda found: None not in found)
        await driver.write([(TAGS[0], 100), (TAGS[1], 101)])
        assert driver.statistics()["late_read_backs"] >= 2
    assert habit.requests.count((16, 0, 2)) == 1 and (habit.registers[0], habit.registers[1]) == (100, 101)


async def test_a_write_refused_as_busy_is_sent_again_and_no_other_is() -> None:
    habit = Habit(busy=1)
    async with driven(habit, timeout=1.0) as driver:
        for _ in range(3):
            await driver.write([(TAGS[0], 9)])
        assert driver.statistics()["busy"] > 0
    habit = Habit()
    habit.answer = lambda pdu: bytes((pdu[0] | 0x80, 4)) if pdu[0] == 16 else Habit().answer(pdu)  # type: ignore[method-assign]
    async with driven(habit, timeout=1.0) as driver:
        with pytest.raises(DeviceException):
            await driver.write([(TAGS[0], 9)])


async def test_without_its_setting_the_habit_is_named() -> None:
    for habit, word in ((Habit(transaction=0), 'transaction_id = "any"'), (Habit(unit=0), "answers_as = 0")):
        async with driven(habit) as driver:
            sample = (await driver.read(TAGS))[0]
            assert not sample.quality.is_good and word in sample.reason


async def test_waiting_on_a_line_says_what_went_wrong_before() -> None:
    async with driven(Habit(serial=True, echo=True)) as driver:
        await driver.read(TAGS)
        sample = (await driver.read(TAGS))[0]
        assert "set echo = true" in sample.reason


@pytest.mark.parametrize("habit", [Habit(late=0.4), Habit(quiet=0.5)], ids=["slow", "quiet"])
async def test_the_first_question_by_hand_is_waited_for(habit: Habit) -> None:
    async with served(habit) as settings:
        del settings["timeout"]
        async with open_survey(settings, clock=asyncio.get_running_loop().time) as survey:
            words = await survey.read("holding", 3, 1)
            assert words.words == (3,)
            assert survey.statistics()["seconds_to_first"] >= max(habit.late, habit.quiet) / 2
            assert (await survey.read("holding", 4, 1)).words == (4,)


async def test_a_device_that_is_not_there_is_said_to_be_silent() -> None:
    async with served(Habit(quiet=1e9)) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        with pytest.raises(ReplyTimeout):
            await survey.read("holding", 0, 1)
        assert not survey.statistics()["foreign_replies"]


# ---------------------------------------------------------------- the table of habits

WALKED = [row for row in HABITS if row.wire]
_APART = ({"quiet", "ends_connections"}, {"hidden", "stale"})
"""Habits that no device has together: one that is quiet after each connection and ends each would never be read."""


async def walk(rows: Sequence[DeviceHabit], link: str, folder: Path) -> None:
    """A device with these habits is read, all but what it refuses, and takes a block; nothing wrong is good."""
    needs = {key: value for row in rows for key, value in row.needs.items()}
    line = link in (LINE, PTY)
    habit = Habit(serial=line, **{key: value for row in rows for key, value in row.wire.items()})
    own = {"timeout": 0.5, "longest_reply": 0.6} if line else {"timeout": 0.5}
    silent = set() if habit.silent_at < 0 else {habit.silent_at}
    lost = {4, 5} if silent and habit.even else silent
    async with driven(habit, link, folder, **own, **needs) as driver:
        found = await values(driver, lambda found: found.count(None) == len(lost))
        assert {place for place, value in enumerate(found) if value is None} == lost
        async with asyncio.timeout(60):
            while True:
                try:
                    await driver.write([(TAGS[0], 100), (TAGS[1], 101)])
                    break
                except (LinkDown, NotAsked):
                    # It hung up, or an old answer is waited for: whether to write again is the caller's to decide.
                    await asyncio.sleep(0.01)
                except WriteUnverified as error:
                    # One that hangs up under a question whose answer would not say what it answers is waited for.
                    assert habit.ends_connections and "not asked" in str(error), link
                    break
        assert (habit.registers[0], habit.registers[1]) == (100, 101)


@pytest.mark.parametrize(
    ("row", "link"), [(row, link) for row in WALKED for link in row.over], ids=lambda of: getattr(of, "habit", of)
)
async def test_each_habit_is_read_alone(row: DeviceHabit, link: str, tmp_path: Path) -> None:
    await walk([row], link, tmp_path)


def drawn(rng: random.Random) -> tuple[list[DeviceHabit], str]:
    """Two or three habits that a device may have together, and its link."""
    while True:
        link = rng.choice((TCP, LINE, TLS, PTY))
        rows = rng.sample([row for row in WALKED if link in row.over], rng.choice((2, 3)))
        wires = {key for row in rows for key in row.wire}
        if not any(apart <= wires for apart in _APART):
            return rows, link


async def test_drawn_habits_together_leave_every_other_register_readable(tmp_path: Path) -> None:
    rng = random.Random(39)
    await asyncio.gather(*(walk(*drawn(rng), tmp_path) for _ in range(60)))


def test_the_page_of_habits_is_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m tests.rig.device_habits"
    known = set(ModbusSettings.model_fields) | set(TagTable.model_fields) | set(DeviceFile.model_fields)
    for row in HABITS:
        named = re.findall(r"[a-z_]{4,}", re.sub(r'"[^"]*"', "", row.setting.replace("a list", "")))
        assert set(named) <= known and set(row.needs) <= known, row.habit
        path, _, name = row.test.partition("::")
        assert f"def {name}(" in (PAGE.parents[1] / path).read_text(encoding="utf-8"), row.habit
        assert all(re.fullmatch(r"[\w.-]+/[\w.-]+#\d+", thread) for thread in row.threads), row.habit
