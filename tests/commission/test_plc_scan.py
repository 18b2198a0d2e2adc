"""`decanter plc scan`: the map of what can be read, units, nodes and frames."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.can.bus.hub import Hub
from drivers.errors import ReplyTimeout
from drivers.modbus.settings import read_settings
from drivers.modbus.survey import ModbusSurvey
from drivers.survey import ReadWords
from gateway.commission.survey.register_map import ReadableMap, search
from gateway.commission.survey.registers import _Asking
from tests.commission.bench import answer, at, plc
from tests.plc.bench import DECANTER, ROOT, Process, running

CANOPEN, CAN = ROOT / "config/devices/decanter_canopen.toml", ROOT / "config/devices/decanter_can.toml"
stretches = st.lists(st.tuples(st.integers(0, 299), st.integers(1, 90)), max_size=5)


def explored(
    readable: set[int], limit: int, seams: set[int], first: int, count: int, budget: int = 100_000
) -> ReadableMap:
    """The search on a device that reads these addresses, blocks up to `limit`, and not across seams."""
    steps = search(first, count, most=125, budget=budget)
    try:
        start, length = next(steps)
        while True:
            block = range(start, start + length)
            answered = length <= limit and readable.issuperset(block) and not seams & set(block[1:])
            start, length = steps.send(answered)
    except StopIteration as stop:
        found: ReadableMap = stop.value
        return found


@settings(max_examples=60, deadline=None)
@given(stretches, st.sampled_from([1, 2, 7, 16, 64, 120, 125]), st.sets(st.integers(1, 299), max_size=1))
def test_the_map_is_exactly_what_the_device_reads_and_the_largest_block_is_its_own(
    ranges: list[tuple[int, int]], limit: int, seams: set[int]
) -> None:
    readable = {at for start, length in ranges for at in range(start, min(300, start + length))}
    found = explored(readable, limit, seams, 0, 300)
    assert {at for start, length in found.readable for at in range(start, start + length)} == readable
    assert not found.unknown
    longest, run = 0, 0
    for number in range(300):
        run = 0 if number not in readable else 1 if number in seams else run + 1
        longest = max(longest, run)
    assert found.largest == min(limit, longest)
    assert found.too_long in (0, limit + 1)


def test_two_addresses_that_are_not_read_together_say_nothing_of_blocks_elsewhere() -> None:
    found = explored({298, 299}, 2, {299}, 0, 300)
    assert found.seams == [299] and found.too_long == 0 and found.largest == 1
    longer = explored({10, 11, 12, 13, 298, 299}, 2, {299}, 0, 300)
    assert longer.largest == 2 and longer.too_long in (0, 3)


@settings(max_examples=30, deadline=None)
@given(stretches, st.integers(1, 60))
def test_the_bound_on_requests_holds_and_what_it_leaves_open_is_not_called_refused(
    ranges: list[tuple[int, int]], budget: int
) -> None:
    readable = {at for start, length in ranges for at in range(start, min(300, start + length))}
    found = explored(readable, 16, set(), 0, 300, budget)
    assert found.requests <= budget
    refused = {at for start, length in found.refusals for at in range(start, start + length)}
    assert refused.isdisjoint(readable)


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, Path]]:
    hub = tmp_path_factory.mktemp("bus") / "can.hub"
    options = ["--max-registers", "16", "--unknown-unit", "exception", "--canopen", CANOPEN, "--can", CAN]
    options += ["--can-interface", "hub", "--can-channel", hub]
    with Hub(hub), running(*options) as process:
        yield process, hub


def test_a_forbidden_register_and_a_limit_of_16_are_found_in_an_unknown_plc(
    device: tuple[Process, Path], tmp_path: Path
) -> None:
    process, _ = device
    number = process.fault("illegal_register", registers=["holding:103"])
    data = answer(tmp_path, "scan", "registers", "holding:90-460", *at(process))
    process.order("clear", number=number)
    assert [(row["first"], row["last"]) for row in data["readable"]] == [
        ("holding:100", "holding:102"),
        ("holding:104", "holding:129"),
        ("holding:400", "holding:425"),
        ("holding:430", "holding:455"),
    ]
    assert data["readable"][0]["reference"] == "40101-40103"
    assert (data["largest_block"], data["too_long"], data["unknown"]) == (16, 17, [])
    assert data["requests"] < 2 * 371


def test_a_small_bound_leaves_addresses_unasked_and_says_so(device: tuple[Process, Path], tmp_path: Path) -> None:
    process, _ = device
    data = answer(tmp_path, "scan", "registers", "40091-40431", *at(process), "--requests", 40)
    assert data["requests"] == 40
    assert data["unknown"] and "were not asked" in data["notes"][0]


def test_a_table_that_the_device_does_not_offer_is_its_exception(tmp_path: Path) -> None:
    with running() as process:
        process.fault("exception", code=1)
        result = plc(tmp_path, "scan", "registers", "input:0-9", *at(process))
    assert result.exit_code == 4
    assert "illegal function" in result.stderr


async def test_silence_at_one_address_is_a_refusal_while_the_device_still_answers_elsewhere() -> None:
    class Mute(ModbusSurvey):
        async def read(self, area: str, start: int, count: int, unit: int | None = None) -> ReadWords:
            if start <= 5 < start + count:
                raise ReplyTimeout("no reply")
            return ReadWords((0,) * count, 0.001)

    asking = _Asking(Mute(read_settings({"host": "127.0.0.1"}), time.time), "holding")
    assert await asking.answers(0, 5)
    assert not await asking.answers(4, 3)
    assert asking.reasons == {"no reply": 1}


def test_units_that_answer_are_found_among_those_that_do_not(device: tuple[Process, Path], tmp_path: Path) -> None:
    process, _ = device
    data = answer(tmp_path, "scan", "units", "1-40,247", *at(process))
    assert [row["unit"] for row in data["units"]] == [1]
    assert data["units"][0]["identity"].startswith("decanter")
    assert data["asked"] == 41


def test_the_node_on_the_bus_is_found_by_sdo_and_by_its_heartbeat(device: tuple[Process, Path], tmp_path: Path) -> None:
    bus = ("--link", "canopen", "--interface", "hub", "--channel", device[1])
    data = answer(tmp_path, "scan", "nodes", "1-5", *bus)
    assert [(row["node"], row["sdo"]) for row in data["nodes"]] == [(1, True)]
    assert data["exchanges"]["lost"] == 4
    heard = answer(tmp_path, "scan", "nodes", *bus, "--listen-only")
    assert [row["node"] for row in heard["nodes"]] == [1]
    assert heard["frames"]["sent"] == 0


def test_frames_on_the_bus_are_listed_with_their_names_and_nothing_is_sent(
    device: tuple[Process, Path], tmp_path: Path
) -> None:
    bus = ("--link", "can", "--interface", "hub", "--channel", device[1], "--dbc", ROOT / "config/decanter.dbc")
    end = time.monotonic() + 60.0
    while True:  # a busy machine has the PLC speak late
        data = answer(tmp_path, "scan", "frames", *bus, "--seconds", 0.6)
        rows = {row["id"]: row for row in data["ids"]}
        if time.monotonic() > end or rows["0x100"]["period_ms"] == pytest.approx(20.0, rel=0.3):
            break
    assert rows["0x100"]["what"] == "PlcStatus" and rows["0x701"]["what"] == "CANopen heartbeat of node 1"
    assert rows["0x100"]["period_ms"] == pytest.approx(20.0, rel=0.3)
    assert data["heard"] == sum(row["frames"] for row in rows.values())
    assert data["exchanges"]["heard"] >= data["heard"] and data["exchanges"]["asked"] == 0


def test_a_bus_on_which_nobody_speaks_is_a_timeout(tmp_path: Path) -> None:
    with Hub(tmp_path / "can.hub"):
        begun = time.monotonic()
        result = plc(
            tmp_path, "scan", "frames", "--link", "can", "--interface", "hub", "--channel", tmp_path / "can.hub",
            "--seconds", 0.2,
        )  # fmt: skip
    assert result.exit_code == 5 and "no frame in 0.2 s" in result.stderr
    assert time.monotonic() - begun < 120


@pytest.mark.parametrize(
    ("command", "words"), [("units", "units are Modbus's"), ("registers", "registers are Modbus's")]
)
def test_what_a_link_does_not_have_is_said_in_a_sentence(tmp_path: Path, command: str, words: str) -> None:
    result = plc(tmp_path, "scan", command, "--device", CAN, "--interface", "hub", "--channel", "x")
    assert result.exit_code == 2 and words in result.stderr
    assert plc(tmp_path, "scan", "nodes", "--device", DECANTER, "--host", "h").exit_code == 2
