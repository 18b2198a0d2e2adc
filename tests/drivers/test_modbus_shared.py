"""Several units behind one connection: fair turns, the device's limits, a silent unit apart, no reply of another's."""

import asyncio
import re
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any

import pytest

from drivers.connections import Connections
from drivers.driver import open_driver
from drivers.errors import DriverError, LinkDown, ReplyTimeout
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.turns import URGENT_IN_A_ROW, Turns
from drivers.tag import Quality, Sample, Tag
from tests.drivers.conftest import read_until_good
from tests.drivers.scripted import Bend, ScriptedPlc, mbap, read_reply, silent, transaction_of
from tests.drivers.scripted_line import PtyLine, ScriptedLine, rtu

FIVE = Tag("five", "holding:5")
SETPOINT = Tag("setpoint", "holding:20")
Open = Callable[..., Any]


def unit_of(request: bytes) -> int:
    return request[6]


def by_unit(bends: dict[int, Bend]) -> Bend:
    """Each unit's reply holds its own number in every register, or is what its bend makes of it."""

    async def bend(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        unit = unit_of(request)
        if request[7] == 3:
            honest = read_reply(request, [unit] * int.from_bytes(request[10:12], "big"))
        if unit in bends:
            await bends[unit](plc, request, honest, writer)
        else:
            writer.write(honest)

    return bend


@pytest.fixture
async def shared(plc: ScriptedPlc) -> AsyncIterator[Open]:
    """Open drivers of units behind the scripted PLC that share a connection; they are closed at the end."""
    connections, drivers = Connections(), []

    async def open_(*units: int, **settings: Any) -> list[ModbusDriver]:
        made = []
        for unit in units:
            given = {"host": "127.0.0.1", "port": plc.port, "unit": unit, "timeout": 0.1, "attempts": 1, **settings}
            driver = open_modbus(given, clock=time.time, write_map=(SETPOINT,), connections=connections)
            drivers.append(driver)
            await driver.open()
            made.append(driver)
        return made

    yield open_
    for driver in drivers:
        await driver.close()


async def once(driver: ModbusDriver) -> Sample:
    (sample,) = await driver.read([FIVE])
    return sample


async def until_silent(living: ModbusDriver, *dead: ModbusDriver) -> None:
    """Read all until the dead ones are known to be silent, which needs an answer of the living one in between."""
    async with asyncio.timeout(60):
        while not all(driver.statistics()["silent"] for driver in dead):
            await asyncio.gather(*map(once, (living, *dead)))
            await asyncio.sleep(0.01)


# ------------------------------------------------------------------ turns


async def order_of(turns: Turns, wanted: Sequence[tuple[int, bool, bool]]) -> list[int]:
    """The units in the order of their turns, all asked for while one holds the connection."""
    order: list[int] = []

    async def one(unit: int, urgent: bool, probe: bool) -> None:
        async with turns.turn(unit, urgent=urgent, probe=probe):
            order.append(unit)
            await asyncio.sleep(0)

    async with turns.turn(0, urgent=False, probe=False):
        tasks = [asyncio.ensure_future(one(*row)) for row in wanted]
        await asyncio.sleep(0)
    await asyncio.gather(*tasks)
    return order


async def test_a_unit_with_much_to_ask_has_one_turn_in_the_round() -> None:
    wanted = [(1, False, False)] * 3 + [(2, False, False), (3, False, False)]
    assert await order_of(Turns(1), wanted) == [1, 2, 3, 1, 1]


async def test_who_holds_the_connection_for_long_has_fewer_turns() -> None:
    turns, order = Turns(1), list[int]()

    async def one(unit: int) -> None:
        async with turns.turn(unit, urgent=False, probe=False):
            order.append(unit)
            await asyncio.sleep(0.1 if unit == 1 else 0.0)

    await asyncio.gather(*map(one, (1, 1, 2, 2, 3, 3)))
    assert order[0] == order[-1] == 1, order


async def test_what_is_urgent_goes_first_and_starves_nobody() -> None:
    assert await order_of(Turns(1), [(1, False, False), (2, False, False), (3, True, False)]) == [3, 1, 2]
    many = [(99, False, False)] + [(unit, True, False) for unit in range(1, URGENT_IN_A_ROW + 3)]
    assert (await order_of(Turns(1), many)).index(99) == URGENT_IN_A_ROW


async def test_as_many_turns_as_outstanding_at_a_time_of_which_one_is_a_silent_units() -> None:
    turns, now, most, probes = Turns(3), 0, 0, 0

    async def one(unit: int) -> None:
        nonlocal now, most, probes
        async with turns.turn(unit, urgent=False, probe=unit < 4):
            now, probes = now + 1, probes + (unit < 4)
            most = max(most, now)
            assert probes <= 1
            await asyncio.sleep(0.001)
            now, probes = now - 1, probes - (unit < 4)

    await asyncio.gather(*map(one, range(12)))
    assert most == 3


async def test_who_is_cancelled_while_waiting_or_just_granted_keeps_no_turn() -> None:
    turns = Turns(1)

    async def hold() -> None:
        async with turns.turn(1, urgent=False, probe=False):
            await asyncio.sleep(10)

    tasks = [asyncio.ensure_future(hold()) for _ in range(3)]
    await asyncio.sleep(0)
    tasks[1].cancel()
    await asyncio.sleep(0)
    tasks[0].cancel()
    tasks[2].cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    async with asyncio.timeout(20), turns.turn(2, urgent=False, probe=False):
        pass


# ------------------------------------------------------------------ one connection, its limits


@pytest.mark.parametrize("outstanding", [1, 3])
async def test_units_share_one_connection_and_no_more_is_under_way_than_it_takes(
    plc: ScriptedPlc, shared: Open, outstanding: int
) -> None:
    under_way = most = 0

    async def slow(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        nonlocal under_way, most
        under_way += 1
        most = max(most, under_way)

        def answer() -> None:
            nonlocal under_way
            under_way -= 1
            writer.write(honest)

        asyncio.get_running_loop().call_later(0.005, answer)

    plc.bend = by_unit(dict.fromkeys(range(1, 6), slow))
    drivers = await shared(*range(1, 6), outstanding=outstanding)
    samples = await asyncio.gather(*(once(driver) for driver in drivers for _ in range(3)))
    assert plc.connections == 1
    assert most == outstanding
    assert Counter(sample.value for sample in samples) == dict.fromkeys(range(1, 6), 3)
    assert all(driver.connected for driver in drivers)


async def test_the_least_that_any_of_the_units_takes_is_the_connections_limit(plc: ScriptedPlc, shared: Open) -> None:
    plc.bend = by_unit({})
    careful = await shared(1)
    await shared(2, outstanding=4)
    assert careful[0]._line._shared._turns.outstanding == 1
    await careful[0].close()


async def test_a_pause_between_requests_is_kept_among_the_units(plc: ScriptedPlc, shared: Open) -> None:
    plc.bend = by_unit({})
    drivers = await shared(1, 2, 3, pause_ms=20)
    began = time.monotonic()
    await asyncio.gather(*map(once, drivers))
    assert time.monotonic() - began >= 0.04


async def test_the_last_unit_closes_the_connection_and_one_of_several_does_not(plc: ScriptedPlc, shared: Open) -> None:
    plc.bend = by_unit({})
    first, second = await shared(1, 2)
    await first.close()
    assert (await once(second)).value == 2
    await second.close()
    assert (await once(second)).quality is Quality.NOT_CONNECTED
    await second.open()
    assert (await once(second)).value == 2


async def test_units_that_mean_another_kind_of_connection_are_refused_with_both_values(plc: ScriptedPlc) -> None:
    connections = Connections()
    place = {"host": "127.0.0.1", "port": plc.port}
    first = open_driver("modbus", {**place, "unit": 3}, clock=time.time, connections=connections)
    with pytest.raises(DriverError, match=r"transport is 'rtu-tcp' for unit 4 at .* and 'tcp' for unit 3 on the same"):
        open_driver("modbus", {**place, "unit": 4, "transport": "rtu-tcp"}, clock=time.time, connections=connections)
    # Once nobody uses it any more, the place may be of another kind: it is no longer what it was.
    await first.close()
    line = {**place, "unit": 4, "transport": "rtu-tcp"}
    changed = open_modbus(line, clock=time.time, connections=connections)
    assert changed._line._shared.settings.transport == "rtu-tcp"
    with pytest.raises(DriverError, match="outstanding is 2, and a serial line carries 1 request at a time"):
        open_driver("modbus", {**place, "transport": "rtu-tcp", "outstanding": 2}, clock=time.time)


# ------------------------------------------------------------------ silent units


@pytest.mark.parametrize("outstanding", [1, 2])
async def test_a_silent_unit_is_asked_rarely_and_read_again_when_it_answers(
    plc: ScriptedPlc, shared: Open, outstanding: int
) -> None:
    dead: dict[int, Bend] = {2: silent, 3: silent}
    plc.bend = by_unit(dead)
    living, two, three = await shared(1, 2, 3, outstanding=outstanding, silent_first=0.15, silent_cap=0.3)

    async def scan(driver: ModbusDriver, seen: list[Sample], stop: asyncio.Event) -> None:
        while not stop.is_set():
            seen.append(await once(driver))
            await asyncio.sleep(0.01)

    assert (await once(living)).value == 1
    await until_silent(living, two, three)
    assert (await once(living)).value == 1
    assert not two.connected and living.connected
    connections = plc.connections
    stop = asyncio.Event()
    seen: list[list[Sample]] = [[], [], []]
    plc.requests.clear()
    scans = [asyncio.ensure_future(scan(*row, stop)) for row in zip((living, two, three), seen, strict=True)]
    loop = asyncio.get_running_loop()
    began = loop.time()
    await asyncio.sleep(0.7)
    async with asyncio.timeout(60):
        while not {2, 3} <= (asked := Counter(map(unit_of, plc.requests))).keys():
            await asyncio.sleep(0.01)
    # At least 0.15, 0.3, 0.3 s apart: 4 times in 0.7 s.
    most = 2 + (loop.time() - began) / 0.3
    assert asked[2] <= most and asked[3] <= most, asked
    assert all(sample.value == 1 for sample in seen[0])
    assert {sample.quality for sample in seen[1]} <= {Quality.NOT_CONNECTED, Quality.TIMEOUT}
    assert any("unit 2 is silent for" in sample.reason and "asked again in" in sample.reason for sample in seen[1])
    assert plc.connections == connections
    dead.clear()
    for driver in (two, three):
        await read_until_good(driver, FIVE)
    stop.set()
    await asyncio.gather(*scans)
    assert two.connected and three.connected


async def test_nothing_is_written_to_a_silent_unit(plc: ScriptedPlc, shared: Open) -> None:
    plc.bend = by_unit({2: silent})
    living, dead = await shared(1, 2, silent_first=30.0, silent_cap=30.0, timeout=0.03)
    await until_silent(living, dead)
    plc.requests.clear()
    with pytest.raises(LinkDown, match="unit 2 is silent"):
        await dead.write([(SETPOINT, 7)])
    assert plc.requests == []


async def test_a_unit_that_the_gateway_has_no_way_to_is_a_silent_one(plc: ScriptedPlc, shared: Open) -> None:
    async def no_way(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        writer.write(mbap(transaction_of(request), unit_of(request), bytes((request[7] | 0x80, 11))))

    plc.bend = by_unit({2: no_way})
    living, dead = await shared(1, 2, silent_first=30.0, silent_cap=30.0)
    await until_silent(living, dead)
    asked = len(plc.requests)
    assert (await once(dead)).quality is Quality.NOT_CONNECTED
    assert len(plc.requests) == asked and plc.connections == 1 and living.connected


async def test_a_connection_on_which_all_units_are_silent_is_made_anew(plc: ScriptedPlc, shared: Open) -> None:
    drivers = await shared(1, 2, 3, 4, timeout=0.05)
    plc.bend = by_unit({})
    await asyncio.gather(*map(once, drivers))
    old = set(plc._writers)

    async def deaf(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        if writer not in old:
            writer.write(honest)

    plc.bend = by_unit(dict.fromkeys(range(1, 5), deaf))
    await asyncio.gather(*(read_until_good(driver, FIVE) for driver in drivers))
    assert plc.connections == 2


async def test_a_unit_that_is_never_asked_makes_no_dead_connection_a_silent_unit(
    plc: ScriptedPlc, shared: Open
) -> None:
    """Of two machines one is read: nobody says that the connection lives, so it is made anew as for one alone."""
    read, _ = await shared(1, 2, timeout=0.05)
    plc.bend = by_unit({})
    await once(read)
    old = set(plc._writers)

    async def deaf(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        if writer not in old:
            writer.write(honest)

    plc.bend = by_unit({1: deaf})
    await read_until_good(read, FIVE)
    assert plc.connections == 2 and not read.statistics()["silent"]


async def test_a_write_without_an_answer_ends_the_connection_and_costs_the_others_no_reading(
    plc: ScriptedPlc, shared: Open
) -> None:
    async def no_writes(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        if request[7] == 3:
            writer.write(honest)

    plc.bend = by_unit({2: no_writes})
    living, other = await shared(1, 2, outstanding=2)
    await asyncio.gather(once(living), once(other))
    seen: list[Sample] = []

    async def scan() -> None:
        while plc.connections < 2 or len(seen) < 10:
            seen.append(await once(living))
            await asyncio.sleep(0.005)

    scans = asyncio.ensure_future(scan())
    with pytest.raises(ReplyTimeout):
        await other.write([(SETPOINT, 7)])
    async with asyncio.timeout(60):
        await scans
    assert all(sample.value == 1 for sample in seen), seen
    assert plc.functions().count(16) == 1


# ------------------------------------------------------------------ what one unit can take from the others


def waited(reason: str) -> float:
    """The deadline that a reading's reason speaks of."""
    found = re.search(r"no reply within ([0-9.]+) s", reason)
    assert found, reason
    return float(found[1])


async def test_only_the_first_question_without_an_answer_has_its_whole_deadline(plc: ScriptedPlc, shared: Open) -> None:
    dead: dict[int, Bend] = {}
    plc.bend = by_unit(dead)
    living, other = await shared(1, 2, timeout=0.5)
    await asyncio.gather(once(living), once(other))
    dead[2] = silent
    assert waited((await once(other)).reason) == 0.5
    assert (await once(living)).value == 1
    assert waited((await once(other)).reason) < 0.5
    # A write is never hurried: of what is given up early it is not known whether the device took it.
    with pytest.raises(ReplyTimeout) as raised:
        await other.write([(SETPOINT, 7)])
    assert waited(str(raised.value)) == 0.5


async def test_a_unit_that_has_never_answered_is_waited_for_as_the_others_are_after_its_first_deadline(
    plc: ScriptedPlc, shared: Open
) -> None:
    plc.bend = by_unit({2: silent})
    living, dead = await shared(1, 2, timeout=0.5)
    reasons = []
    async with asyncio.timeout(60):
        while not dead.statistics()["silent"]:
            assert (await once(living)).value == 1
            reasons.append((await once(dead)).reason)
    first, *others = [waited(reason) for reason in reasons if "held up" not in reason]
    assert first == 0.5 and len(others) == 2 and max(others) < 0.5


async def test_a_unit_that_stops_the_whole_connection_does_not_stop_the_next_one_too(
    plc: ScriptedPlc, shared: Open
) -> None:
    asked_two: list[int] = []

    async def blocking(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        asked_two.append(plc.connections)
        await asyncio.sleep(1.0)  # nobody else on this connection is served meanwhile

    blocks: dict[int, Bend] = {}
    plc.bend = by_unit(blocks)
    drivers = await shared(1, 2, 3)
    await asyncio.gather(*map(once, drivers))
    blocks[2] = blocking
    seen: list[Sample] = []

    async def scan(driver: ModbusDriver) -> None:
        while len(seen) < 60:
            sample = await once(driver)
            if driver is not drivers[1] and plc.connections > 1:
                seen.append(sample)
            await asyncio.sleep(0.01)

    async with asyncio.timeout(60):
        await asyncio.gather(*map(scan, drivers))
    assert drivers[1].statistics()["silent"] and drivers[0].connected
    assert asked_two == [1] and plc.connections == 2
    assert {sample.value for sample in seen} == {1, 3}, seen


async def test_garbage_of_one_unit_ends_the_connection_a_few_times_and_loses_no_reading_of_another(
    plc: ScriptedPlc, shared: Open
) -> None:
    bends: dict[int, Bend] = {}

    async def garbage(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        writer.write(bytes(range(40, 56)))

    plc.bend = by_unit(bends)
    living, other = await shared(1, 2)
    await asyncio.gather(once(living), once(other))
    bends[2] = garbage
    reasons = []
    for _ in range(12):
        lost, sample = await asyncio.gather(once(other), once(living))
        assert sample.value == 1, sample.reason
        assert lost.value is None
        reasons.append(lost.reason)
    assert "not Modbus TCP" in reasons[0] and "unit 2 is silent" in reasons[-1]
    assert plc.connections <= 4


async def test_a_unit_that_answers_now_and_then_wastes_no_more_than_its_share(plc: ScriptedPlc, shared: Open) -> None:
    asked = 0

    async def every_other(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        nonlocal asked
        asked += 1
        if asked % 2:
            writer.write(honest)

    plc.bend = by_unit({2: every_other})
    drivers = await shared(1, 2, 3, 4)
    stop, reasons = asyncio.Event(), list[str]()

    async def scan(driver: ModbusDriver) -> None:
        while not stop.is_set():
            sample = await once(driver)
            if driver is drivers[1]:
                reasons.append(sample.reason)
            await asyncio.sleep(0.005)

    began = time.monotonic()
    scans = [asyncio.ensure_future(scan(driver)) for driver in drivers]
    await asyncio.sleep(1.5)
    stop.set()
    await asyncio.gather(*scans)
    in_vain = 0.1 * sum("no reply within" in reason for reason in reasons)
    # One reading's deadline, the last wait, and a quarter of the time.
    assert 0.1 <= in_vain <= 0.2 + 0.25 * (time.monotonic() - began)
    assert any("has held up the others" in reason for reason in reasons)


# ------------------------------------------------------------------ late replies


async def test_what_a_gateway_says_late_of_a_dead_unit_does_not_mean_that_it_is_there(
    plc: ScriptedPlc, shared: Open
) -> None:
    async def no_way(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        refusal = mbap(transaction_of(request), unit_of(request), bytes((request[7] | 0x80, 11)))
        asyncio.get_running_loop().call_later(0.08, writer.write, refusal)

    plc.bend = by_unit({2: no_way})
    living, dead = await shared(1, 2, timeout=0.04, silent_first=30.0, silent_cap=30.0)
    await until_silent(living, dead)
    asked = Counter(map(unit_of, plc.requests))[2]
    foreign = dead.statistics()["foreign_replies"]
    async with asyncio.timeout(60):
        while dead.statistics()["foreign_replies"] < asked:
            await asyncio.gather(once(living), once(dead))
            await asyncio.sleep(0.01)
    assert foreign < asked  # at least one came after the unit was known to be silent
    await asyncio.gather(once(living), once(dead))
    assert Counter(map(unit_of, plc.requests))[2] == asked


async def test_a_late_reply_of_one_unit_is_never_anothers_and_says_that_it_is_there(
    plc: ScriptedPlc, shared: Open
) -> None:
    async def late(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        asyncio.get_running_loop().call_later(0.06, writer.write, honest)

    bends: dict[int, Bend] = {3: late}
    plc.bend = by_unit(bends)
    drivers = await shared(3, 4, 5, timeout=0.04, silent_first=30.0, silent_cap=30.0)
    for _ in range(12):
        samples = await asyncio.gather(*map(once, drivers))
        assert [sample.value for sample in samples[1:]] == [4, 5]
        assert samples[0].value is None
    assert drivers[0].statistics()["foreign_replies"] >= 1
    del bends[3]
    await read_until_good(drivers[0], FIVE)  # and not in 30 s: what came late has told


async def test_a_reply_under_another_units_number_is_refused(plc: ScriptedPlc, shared: Open) -> None:
    async def as_four(plc: ScriptedPlc, request: bytes, honest: bytes, writer: asyncio.StreamWriter) -> None:
        writer.write(honest[:6] + b"\x04" + honest[7:])

    plc.bend = by_unit({3: as_four})
    three, four = await shared(3, 4, outstanding=2)
    wrong, right = await asyncio.gather(once(three), once(four))
    assert wrong.value is None and "from unit 4 and unit 3 was asked" in wrong.reason
    assert right.value == 4


# ------------------------------------------------------------------ a serial line


@pytest.fixture
async def ends() -> AsyncIterator[PtyLine]:
    made = PtyLine(ScriptedLine(others=frozenset({3, 4})))
    made.start()
    yield made
    made.stop()


@pytest.fixture
async def on_line(ends: PtyLine) -> AsyncIterator[list[ModbusDriver]]:
    """Units 3 and 4 on one line, asked with 60 ms of patience; an answer may come for 1 s."""
    connections, drivers = Connections(), []
    for unit in (3, 4):
        given = {"transport": "rtu", "serial": ends.path, "parity": "N", "baud": 115200, "timeout": 0.06}
        given |= {"attempts": 1, "longest_reply": 1.0, "unit": unit, "silent_first": 0.2, "silent_cap": 0.2}
        drivers.append(open_modbus(given, clock=time.time, connections=connections))
        await drivers[-1].open()
    yield drivers
    for driver in drivers:
        await driver.close()


def own_number(request: bytes) -> bytes:
    return rtu(request[0], bytes((3, 2, 0, request[0])))


async def test_a_silent_unit_on_a_line_costs_the_others_one_short_wait_at_a_time(
    ends: PtyLine, on_line: list[ModbusDriver]
) -> None:
    three, four = on_line

    def bend(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        if request[0] == 4:
            line.put(own_number(request))

    ends.line.bend = bend
    loop, took, answered = asyncio.get_running_loop(), [], 0
    for _ in range(20):
        began = loop.time()
        lost, sample = await asyncio.gather(once(three), once(four))
        took.append(loop.time() - began)
        # Now and then a busy machine is too late for 60 ms.
        assert sample.value in (4, None) and lost.value is None
        answered += sample.value == 4
        await asyncio.sleep(0.01)
    assert answered > 15
    # Without anything apart each of the 20 rounds would wait 60 ms for unit 3, and a second for its late reply.
    assert sum(took) < 20 * 0.06
    assert Counter(request[0] for request in ends.line.requests)[3] < 8
    ends.line.bend = lambda line, request, honest: line.put(own_number(request))
    assert (await read_until_good(three, FIVE)).value == 3


@pytest.mark.parametrize("cut", [0, 3, 6])
async def test_a_late_frame_on_a_line_is_taken_out_before_the_reply_that_was_waited_for(
    ends: PtyLine, on_line: list[ModbusDriver], cut: int
) -> None:
    three, four = on_line

    def bend(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        if request[0] == 4:
            # Unit 3's reply to its earlier question comes first, in two pieces; its data looks like a head of unit 4's.
            late = rtu(3, bytes((3, 2, 4, 3)))
            line.put(late[:cut])
            line.later(0.01, late[cut:] + own_number(request))

    ends.line.bend = bend
    assert (await once(three)).value is None
    assert (await once(four)).value == 4
    assert four.statistics()["foreign_replies"] == 1


async def test_another_unit_is_not_asked_in_the_middle_of_a_late_reply(
    ends: PtyLine, on_line: list[ModbusDriver]
) -> None:
    three, four = on_line
    # The tail of unit 3's late reply is a whole reply of unit 4's, checksum and all.
    trap = rtu(4, bytes((3, 2, 0, 99)))
    late = rtu(3, bytes((3, 8)) + trap + b"\0")
    three_words = Tag("wide", "holding:5", dtype="uint64") if False else FIVE

    def bend(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        if request[0] == 4:
            line.put(own_number(request))
        else:
            line.later(0.055, late[:3])
            line.later(0.12, late[3:])

    ends.line.bend = bend
    await three.read([three_words])
    assert (await once(four)).value in (None, 4)
    assert (await read_until_good(four, FIVE)).value == 4


async def test_a_reply_that_breaks_off_holds_the_line_for_a_moment_and_not_for_the_longest_reply(
    ends: PtyLine, on_line: list[ModbusDriver]
) -> None:
    three, four = on_line

    def bend(line: ScriptedLine, request: bytes, honest: bytes) -> None:
        line.put(own_number(request) if request[0] == 4 else rtu(3, bytes((3, 2, 0, 3)))[:4])

    ends.line.bend = bend
    assert (await once(three)).value is None
    assert (await read_until_good(four, FIVE)).value == 4  # an answer may come for 1 s
    assert four.statistics()["reconnects"] == 0


async def test_a_whole_reply_of_another_unit_is_not_taken_on_a_line(ends: PtyLine, on_line: list[ModbusDriver]) -> None:
    _, four = on_line
    ends.line.bend = lambda line, request, honest: line.put(rtu(3, bytes((3, 2, 0, 3))))
    sample = await once(four)
    assert sample.value is None and "from unit 3 and unit 4 was asked" in sample.reason
