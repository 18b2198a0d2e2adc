"""The conformance suite: what ships is what is made, emulator and Structured Text pass it, a wrong PLC fails."""

import asyncio
import json
import time
from collections.abc import AsyncGenerator, AsyncIterator, Awaitable, Callable, Sequence
from contextlib import aclosing, asynccontextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import pytest

from drivers.errors import DriverError, WriteForbidden
from gateway.commission.session.evidence import FrameEvidence
from gateway.commission.session.site import Site
from gateway.commission.session.target import make_target
from gateway.commission.writeback import block_writer
from gateway.commission.writeback.block_writer import BlockWriter, open_block_writers
from gateway.commission.writeback.codegen import write_suite
from gateway.commission.writeback.loop import alarm_loop, heartbeat_loop
from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.suite import Result, each_result, run_steps, run_suite
from gateway.commission.writeback.test import conform, conform_jointly
from gateway.commission.writeback.vectors import SuiteStep, joint_steps, parse, vectors
from gateway.console import CommandResult
from gateway.demo.can_bus import can_hub
from gateway.demo.links import LINKS, TIMEOUT_S
from gateway.machine.writing.arming import arm_in_log, sign_arming
from gateway.settings.devices import BLOCK_FIELDS, load_device
from gateway.store.audit import DISARMED, AuditEntry, open_audit, read
from sim.plc.record.recording import read_recording
from tests.plc.bench import Process, running
from tests.plc_side.sides import Beside, Compiled, Emulated
from tests.plc_side.test_structured_text import DOCS, PLC, fewer_fields, map_with

SHIPPED = DOCS / "decanter_plc.json"
CYCLE_S = 0.005
"""The cycle of a software PLC here, and how often it is asked: each account takes four of its cycles."""
TIMER_S = 0.7
"""The timer of the software PLCs here, on a machine that has nothing else to do."""


def quiet(_name: str, _share: float) -> None:
    """Nobody watches."""


async def results(side: Emulated | Compiled, path: Path = PLC) -> list[Result]:
    device = load_device(path)
    assert device.writeback is not None
    names = [field.name for field in device.writeback.fields]
    return await run_suite(vectors(device.writeback), side, device.refusals, names)


def test_the_shipped_suite_is_the_one_that_is_made_today(tmp_path: Path) -> None:
    write_suite(PLC, tmp_path / "suite.json")
    assert (tmp_path / "suite.json").read_text() == SHIPPED.read_text(), (
        "make it anew: decanter plc codegen --out out/block.st --suite docs/conformance/decanter_plc.json"
    )
    layout = load_device(PLC).writeback
    assert layout is not None
    shipped = json.loads(SHIPPED.read_text())
    assert parse(shipped) == vectors(layout) and parse(shipped, "together") == joint_steps(layout)
    with pytest.raises(ValueError, match="has format 1"):
        parse({"format": 1})


@pytest.mark.parametrize("side", [Emulated, Compiled])
async def test_the_shipped_vectors_pass(side: Callable[[Path], Emulated | Compiled]) -> None:
    steps = parse(json.loads(SHIPPED.read_text()))
    device = load_device(PLC)
    assert device.writeback is not None
    names = [field.name for field in device.writeback.fields]
    done = await run_suite(steps, side(PLC), device.refusals, names)
    assert len(done) == len(steps) > 80
    assert [one for one in done if not one.passed] == []


@pytest.mark.parametrize("side", [Emulated, Compiled])
async def test_another_layout_and_other_numbers_of_the_reasons_pass_too(
    tmp_path: Path, side: Callable[[Path], Emulated | Compiled]
) -> None:
    fewer = fewer_fields(tmp_path)
    assert len(load_device(fewer).writeback.fields) == 18  # type: ignore[union-attr]
    assert [one for one in await results(side(fewer), fewer) if not one.passed] == []
    renumbered = map_with(
        tmp_path, ('3 = "CRC", 4 = "heartbeat did not change"', '13 = "CRC", 14 = "heartbeat did not change"')
    )
    assert [one for one in await results(side(renumbered), renumbered) if not one.passed] == []


MUTANTS = {
    "no version": ("Words[0] <> WORD#16#0002", "FALSE"),
    "no torn check": ("Words[1] <> Words[25]", "FALSE"),
    "no checksum": ("Words[24] <> Checksum", "FALSE"),
    "another polynomial": ("WORD#16#1021", "WORD#16#8005"),
    "no heartbeat": ("Open AND (Words[2] = HeldHeartbeat)", "FALSE"),
    "no timer": ("Open AND (Watch.Q OR ", "Open AND ("),
    "a refused block restarts the timer": ("Watch(IN := NOT Taken", "Watch(IN := NOT Changed"),
    "validity is not looked at": ("(Validity AND WORD#16#0001) <> WORD#16#0000", "TRUE"),
    "any validity will do": ("(Validity AND WORD#16#0001)", "(Validity AND WORD#16#001F)"),
    "no permit": ("ELSIF NOT Permit THEN", "ELSIF FALSE THEN"),
    "the sequence has to grow": (
        "Words[1] <> Words[25]",
        "(Words[1] <> Words[25]) OR (WORD_TO_UINT(Words[1]) < UINT#41)",
    ),
    "refusals are not counted": ("BlocksRefused := BlocksRefused + UINT#1", "BlocksRefused := BlocksRefused"),
    "the wrong reason": ("Reason := UINT#3", "Reason := UINT#2"),
    "twice the time": ("T#5000ms", "T#10000ms"),
    "no challenge": ("Ended OR (WORD_TO_UINT(Words[22]) <> Challenge)", "FALSE"),
    "the challenge stays": ("Sessions := Sessions + UINT#1", "Sessions := Sessions"),
    "any writer": ("Open AND (Writer <> SessionWriter)", "FALSE"),
    "a writer of no number": ("(Writer = UINT#0) OR", "FALSE OR"),
    "an old sequence": ("(Ahead < UINT#1) OR (Ahead > UINT#100)", "Ahead < UINT#1"),
    "the same sequence": ("(Ahead < UINT#1) OR ", ""),
    "validity 0 ends nothing": ("(Watch.Q OR (Validity = WORD#16#0000))", "Watch.Q"),
    "a session outlives the permit": ("Ended := Permit <> Permitted", "Ended := FALSE"),
    "the other writer is not named": ("RefusedWriter := Writer", "RefusedWriter := UINT#0"),
}


async def noticed(results: AsyncGenerator[Result, None]) -> bool:
    """Whether a step finds something wrong; those after it are not put."""
    async with aclosing(results):
        async for result in results:
            if result.wrong:
                return True
    return False


@pytest.mark.parametrize("name", MUTANTS)
async def test_a_plc_that_leaves_a_check_out_fails_the_suite(name: str) -> None:
    old, new = MUTANTS[name]
    assert old in generate(load_device(PLC))
    side, device = Compiled(PLC, lambda content: content.replace(old, new)), load_device(PLC)
    assert device.writeback is not None
    names = [field.name for field in device.writeback.fields]
    assert await noticed(each_result(vectors(device.writeback), [side], device.refusals, names))


# ---------------------------------------------------------------- several blocks


async def both(plc: Emulated | Compiled) -> list[Result]:
    """All of them together, then the second by itself: the first has passed in other tests."""
    device = load_device(PLC)
    assert device.writeback is not None and len(device.writebacks) == 2
    sides = [Beside(plc, layout.place) for layout in device.writebacks]
    done = await run_steps(joint_steps(device.writeback), sides, device.refusals, BLOCK_FIELDS)
    return done + await run_suite(vectors(device.writeback), sides[1], device.refusals, BLOCK_FIELDS)


@pytest.mark.parametrize("side", [Emulated, Compiled])
async def test_the_other_bearings_block_passes_too_and_neither_is_ever_usable_by_what_was_sent_to_the_other(
    side: Callable[[Path], Emulated | Compiled],
) -> None:
    done = await both(side(PLC))
    assert len(done) > 100 and [one for one in done if not one.passed] == []


SPILLING = {
    "the challenges are counted anew for each block": ("Sessions * UINT#2 + Place", "Sessions"),
    "the blocks share a challenge": ("Sessions * UINT#2 + Place", "Sessions * UINT#2"),
    "one instance answers for both": ("GatewayAlimentazione.Usable", "Gateway.Usable"),
    "one area is looked at twice": ("Words := AreaAlimentazione", "Words := Area"),
}


@pytest.mark.parametrize("name", SPILLING)
async def test_a_plc_whose_blocks_spill_over_fails_the_suite(name: str) -> None:
    old, new = SPILLING[name]
    assert old in generate(load_device(PLC), program=Program())
    plc, device = Compiled(PLC, lambda content: content.replace(old, new)), load_device(PLC)
    assert device.writeback is not None
    sides = [Beside(plc, layout.place) for layout in device.writebacks]
    assert await noticed(each_result(joint_steps(device.writeback), sides, device.refusals, BLOCK_FIELDS))


# ---------------------------------------------------------------- over the wire


@asynccontextmanager
async def at_the_wire(
    folder: Path, link: str, plc: Process, path: Path, *, armed: bool = True, slower: float = 1.0
) -> AsyncIterator[tuple[BlockWriter, ...]]:
    """A hand at the software PLC over a link, armed, with somebody who turns the permit's switch."""

    def ask(question: str) -> bool:
        if "write permit" in question:
            assert plc.order("permit", on="give" in question)["ok"]
        return True

    audit = folder / "audit.sqlite"
    if armed:
        now = time.time()
        arm_in_log(audit, sign_arming("Ada", "suite", 5, now), now)
    settings = {**LINKS[link].settings(folder, plc.ready), "timeout": slower * TIMEOUT_S}
    target = make_target(None, path, None if link.startswith("modbus") else link, settings)
    async with open_block_writers(Site(target, FrameEvidence()), audit, ask) as writers:
        yield writers


@pytest.fixture
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """The PLC is asked as often as the short cycle of these PLCs is worth, so that the suite waits little."""
    monkeypatch.setattr(block_writer, "_POLL_S", CYCLE_S)


def quick(folder: Path, name: str, seconds: float = TIMER_S) -> Path:
    """The device file with a short timer, so that the suite waits little."""
    from gateway.console.places import config_dir

    content = (config_dir() / "devices" / name).read_text().replace("timeout_s = 5.0", f"timeout_s = {seconds}")
    path = folder / name
    path.write_text(content.replace("../decanter.", f"{config_dir()}/decanter."))
    return path


@dataclass
class Pace:
    """Notes when each of the steps begins, and tells whether one took a quarter of the PLC's timer too long.

    What comes after the timer has run out is another step than what was meant: that run tells nothing of the PLC.
    """

    steps: Sequence[SuiteStep] = ()
    begun: list[float] = field(default_factory=list)

    def __call__(self, _name: str, _share: float) -> None:
        self.begun.append(time.monotonic())

    def lagged(self, timer_s: float) -> bool:
        took = [end - begin for begin, end in pairwise([*self.begun, time.monotonic()])]
        late = [spent - step.wait_s for spent, step in zip(took, self.steps, strict=False)]
        return max(late, default=0.0) > timer_s / 4


SLOWER = (1.0, 4.0, 16.0)
Put = Callable[[Path, float, Pace], Awaitable[CommandResult]]
"""Put the suite to a PLC in a folder, with all times so many times as long; its result."""


async def put_in_time(folder: Path, put: Put, timer_s: float = TIMER_S, skipped: int = 0) -> tuple[Path, CommandResult]:
    """The folder and the result of the suite; put anew to a PLC with longer times where it failed and a step lagged,
    or where more steps than `skipped` could not be put.

    A busy machine may be too slow for a short timer; for the last one of three it would have to stand still.
    """
    for slower in SLOWER:
        (at := folder / f"times {slower:g}").mkdir()
        pace = Pace()
        try:
            outcome = await put(at, slower, pace)
        except DriverError:
            # Before the first step it is the link that did not open in time.
            if slower == SLOWER[-1] or (pace.begun and not pace.lagged(slower * timer_s)):
                raise
            continue
        few = outcome.data.get("skipped", 0) <= skipped
        if few and (outcome.code == 0 or not pace.lagged(slower * timer_s)):
            break
    return at, outcome


@pytest.mark.usefixtures("often")
async def test_the_emulator_passes_over_modbus_and_its_recorder_has_every_block(tmp_path: Path) -> None:
    async def put(folder: Path, slower: float, pace: Pace) -> CommandResult:
        path = quick(folder, "decanter_plc.toml", slower * TIMER_S)
        with running("--record", folder / "rec.jsonl", "--cycle", str(CYCLE_S), map_path=path) as plc:
            async with at_the_wire(folder, "modbus", plc, path, slower=slower) as (one, _):
                pace.steps = steps = vectors(one.layout, flips=2)
                return await conform(one, pace, steps)

    tmp_path, outcome = await put_in_time(tmp_path, put, skipped=1)
    assert outcome.code == 0, outcome.complaint
    assert outcome.data["passed"] == outcome.data["steps"] - 1, "but the block that is written without a permit"
    written = read_recording(tmp_path / "rec.jsonl").blocks
    logged = read(tmp_path / "audit.sqlite", ["write"])
    assert [row.entry.detail["words"] for row in logged] == ["".join(f"{w:04x}" for w in row.words) for row in written]
    assert len(read(tmp_path / "audit.sqlite", ["write refused"])) == 1
    assert written[-1].fields is not None and written[-1].fields["validity"] == 0, "the last word takes all back"


@pytest.mark.usefixtures("often")
async def test_both_blocks_together_pass_over_one_connection(tmp_path: Path) -> None:
    blocks: list[dict[str, object]] = []

    async def put(folder: Path, slower: float, pace: Pace) -> CommandResult:
        path = quick(folder, "decanter_plc.toml", slower * TIMER_S)
        with running("--cycle", str(CYCLE_S), map_path=path) as plc:
            async with at_the_wire(folder, "modbus", plc, path, slower=slower) as writers:
                pace.steps = joint_steps(writers[0].layout)
                outcome = await conform_jointly(writers, pace)
            blocks[:] = plc.order("status")["blocks"]
        return outcome

    _, outcome = await put_in_time(tmp_path, put)
    assert outcome.code == 0 and outcome.data["passed"] == outcome.data["steps"], outcome.complaint
    assert [block["usable"] for block in blocks] == [False, False], "the last word of each takes all back"


@pytest.mark.parametrize("link", ["can", "canopen"])
async def test_the_emulator_passes_over_the_can_bus(tmp_path: Path, link: str, monkeypatch: pytest.MonkeyPatch) -> None:
    seconds, cycle = 1.8, 0.02  # CANopen: a refused block waits for an acknowledge that does not come; a SYNC a cycle
    if link == "can":
        seconds, cycle = TIMER_S, CYCLE_S
        monkeypatch.setattr(block_writer, "_POLL_S", CYCLE_S)

    async def put(folder: Path, slower: float, pace: Pace) -> CommandResult:
        path, plain = (quick(folder, f"decanter_{name}.toml", slower * seconds) for name in (link, "plc"))
        with can_hub(folder) as hub:
            options = [f"--{link}", path, "--can-interface", "hub", "--can-channel", hub, "--cycle", str(cycle)]
            with running(*options, map_path=plain) as plc:
                async with at_the_wire(folder, link, plc, path, slower=slower) as (_, one):
                    pace.steps = steps = vectors(one.layout, flips=2)
                    return await conform(one, pace, steps)

    _, outcome = await put_in_time(tmp_path, put, seconds, skipped=3)
    assert outcome.code == 0, outcome.complaint
    assert outcome.data["passed"] >= outcome.data["steps"] - 3
    assert outcome.data["passed"] + outcome.data["skipped"] == outcome.data["steps"]


@pytest.mark.usefixtures("often")
async def test_the_loop_tests_pass_at_the_emulator_and_a_plc_without_a_timer_fails(tmp_path: Path) -> None:
    for slower in SLOWER:  # a busy machine may be too slow for a short timer
        (folder := tmp_path / f"times {slower:g}").mkdir()
        path = quick(folder, "decanter_plc.toml", 3.0 * slower * TIMER_S)
        with running("--cycle", str(CYCLE_S), map_path=path) as plc:
            async with at_the_wire(folder, "modbus", plc, path, slower=slower) as (one, _):
                seen = await alarm_loop(one, quiet)
                beats = await heartbeat_loop(one, quiet, seconds=0.3 * slower)
                assert plc.order("force", tag="PredictionUsable", value=True)["ok"]
                await one.wait_for_scans()
                stuck = await heartbeat_loop(one, quiet, seconds=0.3 * slower)
        if seen.code == beats.code == 0:
            break
    assert seen.code == 0 and [row["name"] for row in seen.data["rows"]][-1] == "none"
    assert len(seen.data["rows"]) == 10 and all(row["seen"] for row in seen.data["rows"])
    assert beats.code == 0 and len(beats.data["rows"]) == 4
    assert stuck.code == 1 and "timer" in stuck.complaint


async def test_nothing_is_sent_unarmed_unpermitted_or_when_the_arming_was_taken_back(tmp_path: Path) -> None:
    path = quick(tmp_path, "decanter_plc.toml")
    with running("--record", tmp_path / "rec.jsonl", "--no-permit", map_path=path) as plc:
        with pytest.raises(WriteForbidden, match="not armed"):
            async with at_the_wire(tmp_path, "modbus", plc, path, armed=False):
                pass
        async with at_the_wire(tmp_path, "modbus", plc, path) as (one, _):
            with pytest.raises(WriteForbidden, match="does not permit"):
                await one.block()
            plc.order("permit", on=True)
            await one.wait_for_scans()
            log = open_audit(tmp_path / "audit.sqlite")
            assert log.record(AuditEntry(time.time(), DISARMED, "Bea", "enough"))
            log.close()
            with pytest.raises(WriteForbidden, match="arming is over"):
                await one.block()
        assert read_recording(tmp_path / "rec.jsonl").blocks == ()
    await asyncio.sleep(0)
    kinds = [row.entry.kind for row in read(tmp_path / "audit.sqlite")]
    assert kinds == ["armed", "confirmed", "write refused", "disarmed", "write refused"]
