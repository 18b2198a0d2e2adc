"""A block recorded from the wire, sent again by a plain socket, made the prediction usable; so did a second gateway."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

import pytest

from drivers.settings import ConfigError
from drivers.tag import Tag
from gateway.machine.reading import Scan
from gateway.machine.writing.block import SessionWords, Validity, build
from gateway.machine.writing.writeback import Arming, Writer
from gateway.settings.devices import load_device
from sim.plc.program.checks import InputError
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.faults import parse_fault
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from tests.gateway.support import EPOCH, MAP, JumpClock, scan_of
from tests.plc_side.sides import Compiled, Emulated

DEVICE = load_device(MAP)
LAYOUT = DEVICE.writeback
assert LAYOUT is not None
USABLE = Validity(31)
STEPS = {Emulated: 400, Compiled: 120}


@dataclass
class RandomWriter:
    """A gateway as the PLC sees it: a number of its own, and the challenge that it read last."""

    number: int
    sequence: int = 0
    challenge: int = 0
    words: tuple[int, ...] = field(default=())

    def block(self, random: Random) -> tuple[int, ...]:
        assert LAYOUT is not None
        self.sequence = (self.sequence + random.randint(1, 3)) & 0xFFFF
        session = SessionWords(
            challenge=self.challenge,
            writer=self.number,
            sequence=self.sequence,
            heartbeat=self.sequence % 0xFFFF + 1,
        )
        validity = random.choice((USABLE, USABLE, USABLE, USABLE, Validity.NONE))
        return build(LAYOUT, {}, validity, session).words


@pytest.mark.parametrize(("kind", "seed"), [(Emulated, 0), (Emulated, 1), (Emulated, 2), (Emulated, 3), (Compiled, 0)])
async def test_nothing_recorded_is_accepted_whatever_happens_to_plc_writers_timer_and_permit(
    kind: type[Emulated] | type[Compiled], seed: int
) -> None:
    assert LAYOUT is not None
    random, side = Random(seed), kind(MAP)
    await side.permit(True)
    recorded: list[tuple[int, ...]] = []
    writers = [RandomWriter(random.randint(1, 0xFFFF), random.randrange(0x10000)) for _ in range(2)]
    for _ in range(STEPS[kind]):
        before = await side.account()
        action = random.random()
        if action < 0.45:
            writer = random.choice(writers)
            # A scan comes before most blocks; some follow a challenge that is over.
            writer.challenge = before.challenge if random.random() < 0.8 else writer.challenge
            recorded.append(writer.block(random))
            await side.write(0, recorded[-1])
            await side.account()
        elif action < 0.8 and recorded:
            again = random.choice(recorded[-50:])
            await side.write(0, again)
            after = await side.account()
            assert after.accepted == before.accepted, "a recorded block has been accepted"
            assert before.usable or not after.usable, "a recorded block has made the prediction usable"
        elif action < 0.88:
            await side.wait(random.uniform(0.1, 1.5) * LAYOUT.timeout)
        elif action < 0.94:
            await side.permit(random.random() < 0.7)
        elif action < 0.97:
            await restarted(side)
        else:
            # A gateway begins anew: another number, and a sequence from the start.
            writers[random.randrange(2)] = RandomWriter(random.randint(1, 0xFFFF))


async def restarted(side: Emulated | Compiled) -> None:
    """The PLC's program begins anew, warm: what it retains is there, everything else as at the first start."""
    if isinstance(side, Emulated):
        side.plc.schedule.add(parse_fault({"kind": "restart", "down_s": 0.1, "zeros_s": 0.1}, "test"), side.now)
        for _ in range(200):
            side.now += 0.02
            side.plc.cycle(side.now)
        return
    retained = side.block["Sessions"]
    permit, area = (
        side.program["PermitSwitch"],
        {name: value for name, value in side.program.values.items() if name.startswith("word")},
    )
    fresh = Compiled(MAP)
    side.program, side.by_place, side.ms = fresh.program, fresh.by_place, 0
    side.block.values |= {"sessions": retained, "started": False}
    side.program.values |= {"permitswitch": permit, **area}
    side.run(1)


# ---------------------------------------------------------------- two gateways


CLOCK = JumpClock()


class WireToPlc:
    """Blocks go straight into the software PLC's memory."""

    def __init__(self, plc: Plc) -> None:
        self.plc = plc

    async def write(self, values: Sequence[tuple[Tag, int]], *, before_sending: object = None) -> None:
        assert self.plc.registers.block is not None
        place = self.plc.registers.block.place
        self.plc.write("gateway", place.table, place.address, [word for _, word in values], 0.0)


def scanned(plc: Plc) -> Scan:
    plc.cycle(0.0)
    names = ("WritePermit", "Challenge", "SessionWriter", "RefusedWriter")
    names += ("BlocksAccepted", "BlocksRefused", "LastRefusal")
    return scan_of({name: plc.image.truth[name] for name in names}, CLOCK.now())


def gateway(plc: Plc, number: int) -> Writer:
    assert LAYOUT is not None
    arming = Arming("Ada", "test", EPOCH + 3600.0)
    return Writer(LAYOUT, CLOCK, "armed", number, WireToPlc(plc), arming)  # type: ignore[arg-type]


REASONS = {code: reason for reason, code in DEVICE.refusals.items()}


async def test_of_two_armed_gateways_the_second_is_refused_and_each_names_the_other() -> None:
    plc = Plc(read_map(MAP), EmulatorClock(0.0, 0.0, 1.0))
    plc.begin(0.0)
    first, second = gateway(plc, 101), gateway(plc, 202)
    said: dict[int, str] = {}
    for _ in range(3):
        for one in (first, second):
            scan = scanned(plc)
            said[one.number] = one.take_counts(scan, REASONS)
            attempt = await one.offer(scan, {}, USABLE)
            assert attempt is not None and attempt.verdict == "written", attempt
    assert (plc.intake.accepted, plc.intake.refused) == (3, 3)
    assert "another writer: number 202 was refused" in said[101] and "this gateway is number 101" in said[101]
    assert "another writer: number 101 has the session" in said[202] and "this gateway is number 202" in said[202]
    assert (first.counters.other_writer, second.counters.other_writer) == (202, 101)


async def test_a_session_that_ended_on_the_way_costs_one_block_and_is_no_refusal_to_report() -> None:
    plc = Plc(read_map(MAP), EmulatorClock(0.0, 0.0, 1.0))
    plc.begin(0.0)
    one = gateway(plc, 101)
    await one.offer(scanned(plc), {}, USABLE)
    one.take_counts(scan := scanned(plc), REASONS)
    plc.permit = False
    plc.cycle(0.0)
    plc.permit = True
    plc.cycle(0.0)
    await one.offer(scan, {}, USABLE)
    assert plc.intake.last_refusal == "another challenge"
    after = scanned(plc)
    assert one.take_counts(after, REASONS) == "" and one.counters.sessions_ended == 1
    await one.offer(after, {}, USABLE)
    assert scanned(plc).good("SessionWriter") == 101, "the next scan's challenge opens another session"


@pytest.mark.parametrize("challenge", [0.0, None])
async def test_without_a_challenge_nothing_is_sent_and_the_reason_says_so(challenge: float | None) -> None:
    plc = Plc(read_map(MAP), EmulatorClock(0.0, 0.0, 1.0))
    plc.begin(0.0)
    attempt = await gateway(plc, 101).offer(scan_of({"WritePermit": True, "Challenge": challenge}, EPOCH), {}, USABLE)
    assert attempt is not None and attempt.verdict == "not permitted" and "hallenge" in attempt.reason
    assert plc.intake.accepted + plc.intake.refused == 0


def test_a_map_of_layout_version_1_is_refused_on_both_sides(tmp_path: Path) -> None:
    old = tmp_path / "old.toml"
    old.write_text(MAP.read_text().replace("layout_version = 2", "layout_version = 1"))
    with pytest.raises(ConfigError, match=r"version 1 has no sessions.*give 2.*codegen"):
        load_device(old)
    with pytest.raises(InputError, match="version 1 has no sessions"):
        read_map(old)
