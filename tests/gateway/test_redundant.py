"""Redundant links: one sample a tag and scan, never an older one after a newer, one PLC, each block at most once."""

import asyncio
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pytest

from drivers.driver import BeforeSending, Driver, Explains, Writes, anyhow
from drivers.errors import DeviceException, LinkDown, ReplyTimeout, WriteForbidden
from drivers.tag import Quality, Sample, Tag, Value
from gateway.machine.reading.redundant import RedundancyRules, Redundant, RedundantPath, SwitchOver
from gateway.machine.reading.same_plc import COUNTER_MODULUS, Pulse, agree, still, with_beat

BEAT_S = 0.002
"""The device's heartbeat and its one signal count these."""
COUNT, BEAT, WORD = "Count", "PlcHeartbeat", "Writeback.sequence"
TAGS = (Tag(COUNT, "holding:1"), Tag(BEAT, "holding:2"))


@dataclass
class Device:
    """A PLC whose signal is its own clock, so that every value tells when it was true; and what was written to it."""

    start: float = 0.0
    offset: int = 0
    frozen_at: float | None = None
    word: int = 0
    writes: list[tuple[str, int]] = field(default_factory=list)

    def count(self, now: float) -> int:
        return int(((now if self.frozen_at is None else self.frozen_at) - self.start) / BEAT_S)


@dataclass
class Path:
    """A link to the device that a test can bend: late, silent, refused, stale; and how a write fares on it."""

    name: str
    device: Device
    log: list[str] = field(default_factory=list)
    delay: float = 0.0
    quality: Quality = Quality.GOOD
    down: bool = False
    stale: float | None = None
    fate: str = "stored"
    streams: bool = False

    async def open(self) -> None:
        if self.down:
            raise LinkDown(f"{self.name} refused")

    async def close(self) -> None:
        self.log.append("closed")

    @property
    def connected(self) -> bool:
        return not self.down

    def statistics(self) -> Mapping[str, float]:
        return {"requests": float(len(self.log))}

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        self.log.append("read")
        assert all(tag.address.startswith(self.name) for tag in tags), "each link has its own addresses"
        sent = now()
        looked = sent if self.stale is None else self.stale
        value = self.device.count(looked)
        await asyncio.sleep(self.delay)
        if self.down:
            return [Sample(tag.name, None, Quality.NOT_CONNECTED, now(), reason="refused") for tag in tags]
        if self.quality is not Quality.GOOD:
            return [Sample(tag.name, None, self.quality, now(), sent, "bent") for tag in tags]
        values = {COUNT: value, BEAT: (value + self.device.offset) % COUNTER_MODULUS + 1, WORD: self.device.word}
        times = (looked, None) if self.streams else (now(), sent)
        return [Sample(tag.name, values[tag.name], Quality.GOOD, *times) for tag in tags]

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        before_sending()
        ((tag, value),) = values
        assert tag.address.startswith(self.name)
        if self.fate == "refused":
            raise DeviceException(2, "refused")
        self.device.writes.append((self.name, int(value)))
        if self.fate != "lost":
            self.device.word = int(value)
        if self.fate != "stored":
            raise ReplyTimeout("no reply")


def now() -> float:
    return asyncio.get_running_loop().time()


def way(path: Path) -> RedundantPath:
    tags = (*TAGS, Tag(WORD, "holding:3", writable=True))
    return RedundantPath(path.name, path, {tag.name: Tag(tag.name, f"{path.name}:{tag.address}") for tag in tags})


def redundant(*paths: Path, switch_after: float = 0.05, return_after: float = 0.1, beat: float = 0.05) -> Redundant:
    return Redundant([way(path) for path in paths], RedundancyRules(switch_after, return_after, BEAT, beat), now)


@dataclass
class Pair:
    """Two links to one device, read a few times so that both heartbeats are known."""

    first: Path
    second: Path
    both: Redundant
    switches: list[SwitchOver]


async def pair(**rules: Any) -> Pair:
    device = Device(now())
    first, second = Path("first", device), Path("second", device)
    both = redundant(first, second, **rules)
    made = Pair(first, second, both, [])
    both.on_switch = made.switches.append
    await both.open()
    for _ in range(4):
        await scan(both)
        await asyncio.sleep(0.005)
    assert made.switches == []
    return made


async def scan(both: Redundant) -> Sample:
    """The signal's sample of one scan."""
    samples = await both.read(TAGS)
    assert [sample.tag for sample in samples] == [tag.name for tag in TAGS]
    return samples[0]


# ------------------------------------------------------------------ switching


async def test_it_is_a_driver_that_writes_and_explains() -> None:
    both = redundant(Path("first", Device()), Path("second", Device()))
    assert isinstance(both, Driver) and isinstance(both, Writes) and isinstance(both, Explains)


@pytest.mark.parametrize("bend", [{"down": True}, {"quality": Quality.TIMEOUT}, {"delay": 5.0}], ids=str)
async def test_a_failed_or_late_link_is_left_in_the_same_scan(bend: dict[str, Any]) -> None:
    p = await pair()
    for key, value in bend.items():
        setattr(p.first, key, value)
    begun = now()
    sample = await scan(p.both)
    assert sample.quality is Quality.GOOD and p.first.device.count(begun) <= int(sample.value or 0)
    assert now() - begun < 1.0
    assert [(one.before, one.after) for one in p.switches] == [("first", "second")]
    assert p.switches[0].reason.startswith("first: ")
    assert p.both.statistics()["switch_overs"] == 1
    await p.both.close()


async def test_what_the_device_itself_says_to_be_bad_changes_no_link() -> None:
    p = await pair()
    p.first.quality = Quality.SENSOR_FAILURE
    assert (await scan(p.both)).quality is Quality.SENSOR_FAILURE
    assert p.switches == []


async def test_a_link_whose_heartbeat_stands_still_is_left_while_the_others_moves() -> None:
    p = await pair(beat=0.03)
    p.first.stale = now()
    for _ in range(20):
        await scan(p.both)
        await asyncio.sleep(0.005)
    assert [one.reason for one in p.switches] == ["first: its heartbeat stands still"]


async def test_a_plc_that_stands_still_on_both_links_changes_no_link() -> None:
    p = await pair(beat=0.02)
    p.first.device.frozen_at = now()
    for _ in range(20):
        await scan(p.both)
        await asyncio.sleep(0.005)
    assert p.switches == []


async def test_the_primary_is_used_again_once_it_has_been_well_without_a_break() -> None:
    p = await pair(return_after=0.15)
    p.first.down = True
    await scan(p.both)
    p.first.down = False
    begun, broken = now(), None
    while len(p.switches) < 2 and now() - begun < 60:
        if broken is None and now() - begun > 0.08:
            p.first.down = True
            await scan(p.both)
            p.first.down, broken = False, now()
        await scan(p.both)
        await asyncio.sleep(0.01)
    assert [one.after for one in p.switches] == ["second", "first"]
    assert broken is not None and now() - broken >= 0.15, "a break begins the waiting anew"
    assert p.both.statistics()["returns"] == 1


async def test_a_primary_slower_than_the_standby_is_used_again_without_a_bad_scan() -> None:
    p = await pair(return_after=0.05)
    p.first.down = True
    await scan(p.both)
    p.first.down, p.first.delay = False, 0.02
    begun = now()
    while len(p.switches) < 2 and now() - begun < 60:
        assert (await scan(p.both)).quality is Quality.GOOD
        await asyncio.sleep(0.005)
    assert [one.after for one in p.switches] == ["second", "first"]
    assert (await scan(p.both)).quality is Quality.GOOD
    await p.both.close()


async def test_a_slower_standby_takes_over_with_a_reading_of_that_scan() -> None:
    p = await pair()
    p.second.delay = 0.02
    for _ in range(3):
        await scan(p.both)
    await asyncio.sleep(0.1)
    p.first.down, begun = True, now()
    sample = await scan(p.both)
    assert sample.quality is Quality.GOOD and sample.sent is not None and sample.sent >= begun
    assert p.both.statistics()["held_samples"] == 0


async def test_both_links_away_give_bad_samples_and_the_first_to_come_back_is_used() -> None:
    p = await pair()
    p.first.down = p.second.down = True
    for _ in range(3):
        assert (await scan(p.both)).quality is Quality.NOT_CONNECTED
    p.second.down = False
    assert (await scan(p.both)).quality is Quality.GOOD
    assert p.switches[-1].after == "second"


async def test_opening_needs_one_link_and_says_of_each_why_not() -> None:
    device = Device(now())
    both = redundant(Path("first", device, down=True), Path("second", device))
    await both.open()
    assert (await scan(both)).quality is Quality.GOOD
    none = redundant(Path("first", device, down=True), Path("second", device, down=True))
    with pytest.raises(LinkDown, match="first: first refused; second: second refused"):
        await none.open()


async def test_a_slow_standby_delays_no_scan_and_is_not_asked_twice_at_once() -> None:
    p = await pair()
    p.second.delay = 0.2
    asked = p.second.log.count("read")
    begun = now()
    for _ in range(10):
        assert (await scan(p.both)).quality is Quality.GOOD
    assert p.second.log.count("read") == asked + 1
    assert now() - begun < 0.2, "ten scans while the standby answers one"
    await p.both.close()


async def test_the_report_shows_every_link_and_why_one_is_not_well() -> None:
    p = await pair()
    p.first.down = True
    await scan(p.both)
    first, second = p.both.report()
    assert (first["active"], first["well"], first["reason"]) == (False, False, "refused")
    assert (second["active"], second["well"], second["reason"]) == (True, True, "")
    assert p.both.statistics()["second: requests"] > 0


# ------------------------------------------------------------------ no event lost or doubled


async def test_a_standby_whose_reading_may_be_older_does_not_turn_the_clock_back() -> None:
    p = await pair()
    p.second.streams, p.second.stale = True, now() - 0.001
    newest = await scan(p.both)
    p.first.down = True
    held = await scan(p.both)
    assert held == newest, "the last sample stands"
    assert p.both.statistics()["held_samples"] > 0
    p.second.stale = None
    later = await scan(p.both)
    assert later.time > newest.time and int(later.value or 0) >= int(newest.value or 0)


@pytest.mark.parametrize("seed", range(5))
async def test_under_any_mixture_of_faults_values_never_go_back_and_time_is_monotone(seed: int) -> None:
    rng = random.Random(seed)
    p = await pair(switch_after=0.01, return_after=0.03, beat=10.0)
    before = await scan(p.both)
    for _ in range(150):
        for path in (p.first, p.second):
            path.down = rng.random() < 0.2
            path.delay = rng.choice([0.0, 0.0, 0.0, 0.004, 0.02])
            path.streams = rng.random() < 0.3
            path.quality = rng.choice([Quality.GOOD] * 5 + [Quality.TIMEOUT])
        sample = await scan(p.both)
        if sample.value is not None:
            assert before.value is not None
            assert sample.time >= before.time and sample.value >= before.value, (before, sample)
            before = sample
    assert len(p.switches) > 5
    await p.both.close()


# ------------------------------------------------------------------ the same PLC


async def test_a_standby_that_leads_to_another_plc_is_never_used() -> None:
    p = await pair()
    p.second.device = Device(p.first.device.start, offset=5000)
    for _ in range(6):
        await scan(p.both)
        await asyncio.sleep(0.005)
    assert "another PLC" in p.both.report()[1]["reason"]
    p.first.down = True
    for _ in range(3):
        assert (await scan(p.both)).value is None
    assert p.switches == []


def pulse(*beats: tuple[int, float]) -> Pulse:
    made = Pulse()
    for count, time in beats:
        made = with_beat(made, Sample(BEAT, count, Quality.GOOD, time, time - 0.001))
    return made


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        (pulse((100, 1.0), (150, 2.0)), pulse((100, 1.0), (150, 2.0)), True),
        (pulse((100, 1.0), (150, 2.0)), pulse((100, 1.0), (175, 2.5)), True),
        (pulse((65530, 1.0), (45, 2.0)), pulse((65530, 1.0), (70, 2.5)), True),
        (pulse((100, 1.0), (150, 2.0)), pulse((300, 1.0), (350, 2.0)), False),
        (pulse((100, 1.0), (150, 2.0)), pulse((100, 1.0)), None),
        (pulse((100, 1.0), (101, 2.0)), pulse((101, 2.2), (102, 3.2)), True),
        (pulse((100, 1.0), (101, 2.0)), pulse((111, 2.2), (112, 3.2)), False),
    ],
    ids=["same", "half a second later", "round the ring", "another", "unknown yet", "slow", "slow and another"],
)
def test_two_heartbeats_agree_if_time_explains_their_difference(one: Pulse, other: Pulse, same: bool | None) -> None:
    assert agree(one, other) is same and agree(other, one) is same


def test_a_restart_begins_the_heartbeat_anew_and_zero_is_standing_still() -> None:
    p = pulse((40_000, 1.0), (40_050, 2.0), (0, 3.0))
    assert still(p, 1.0)
    p = with_beat(p, Sample(BEAT, 1, Quality.GOOD, 4.0, 3.9))
    assert not still(p, 1.0) and len(p.beats) == 1
    p = with_beat(p, Sample(BEAT, 1, Quality.GOOD, 5.4, 5.3))
    assert not still(p, 1.0)
    assert still(with_beat(p, Sample(BEAT, 1, Quality.GOOD, 5.6, 5.5)), 1.0)


def test_a_link_that_was_read_long_ago_is_judged_by_what_was_read_then() -> None:
    p = pulse((1, 1.0), (2, 2.0))
    assert not still(p, 0.1)


async def test_a_late_link_is_left_after_switch_after_even_if_heartbeats_are_faster() -> None:
    p = await pair(switch_after=0.2, beat=0.01)
    p.first.delay = 5.0
    begun = now()
    assert (await scan(p.both)).quality is Quality.GOOD
    assert 0.2 <= now() - begun < 1.0
    await p.both.close()


def test_a_bad_reading_of_the_heartbeat_says_nothing() -> None:
    p = pulse((1, 1.0), (2, 2.0))
    assert with_beat(p, Sample(BEAT, None, Quality.TIMEOUT, 3.0)) == p
    assert with_beat(p, None) == p


# ------------------------------------------------------------------ writes


def block(value: int) -> list[tuple[Tag, Value]]:
    return [(Tag(WORD, "anywhere"), value)]


async def test_a_block_goes_over_the_active_link_alone() -> None:
    p = await pair()
    await p.both.write(block(7))
    p.first.down = True
    await scan(p.both)
    await p.both.write(block(8))
    assert p.first.device.writes == [("first", 7), ("second", 8)]


async def test_a_write_whose_reply_is_lost_is_read_back_over_the_other_link_and_never_sent_again() -> None:
    p = await pair()
    p.first.fate = "stored, reply lost"
    await p.both.write(block(7))
    assert p.first.device.writes == [("first", 7)]
    assert p.both.statistics()["confirmed_elsewhere"] == 1


async def test_a_write_that_did_not_arrive_is_raised_and_never_sent_again() -> None:
    p = await pair()
    p.first.fate = "lost"
    with pytest.raises(ReplyTimeout):
        await p.both.write(block(7))
    assert p.first.device.writes == [("first", 7)], "one attempt, none over the standby"
    assert p.both.statistics()["confirmed_elsewhere"] == 0


async def test_a_refused_write_and_a_tag_without_address_are_raised_as_they_are() -> None:
    p = await pair()
    p.first.fate = "refused"
    reads = p.second.log.count("read")
    with pytest.raises(DeviceException):
        await p.both.write(block(7))
    assert p.second.log.count("read") == reads, "a known fate needs no reading back"
    with pytest.raises(WriteForbidden, match="has no address on first"):
        await p.both.write([(Tag("Writeback.other", "x"), 1)])


async def test_a_link_without_an_address_for_the_block_confirms_nothing_and_hides_no_loss() -> None:
    device = Device(now())
    first, second = Path("first", device, fate="stored, reply lost"), Path("second", device)
    reads_only = RedundantPath("second", second, {tag.name: Tag(tag.name, f"second:{tag.address}") for tag in TAGS})
    both = Redundant([way(first), reads_only], RedundancyRules(0.05, 0.1, BEAT, 0.05), now)
    await both.open()
    await scan(both)
    with pytest.raises(ReplyTimeout):  # and not "nothing was sent": the block may be in the device
        await both.write(block(7))


async def test_a_strange_link_confirms_nothing() -> None:
    p = await pair()
    p.first.fate, p.second.down = "stored, reply lost", True
    await scan(p.both)
    with pytest.raises(ReplyTimeout):
        await p.both.write(block(7))
