"""What a bus holds back and gives in a burst is not good in the midst of the burst, and its judge knows its timeouts.

Between two processes the frames go through a third one, the hub. While it stands still nothing comes, and what comes
then begins where it stopped: the first new count of the heartbeat was said long before, though no count that is older
has come since. The demonstration's judge took such readings, and every reading of a message that was missing for less
than its timeout, for wrong values held for good. Times are seconds, those of the demonstration at 100 times real time.
"""

import json
import random
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.can.frame import CanFrame
from drivers.can.reception import MessageRules, Reception
from drivers.tag import Quality, Sample, Tag
from gateway.console import config_dir
from gateway.demo.links import LINKS
from gateway.demo.prepare import DemoRun
from gateway.demo.summary import validity_seconds
from gateway.machine.reading.quality import STALE_PERIODS, DeviceAge, QualityRules, judge
from sim.plc.program.clock import EmulatorClock
from sim.plc.record.judge import wrong_good
from sim.plc.record.recording import PlcRecording, Run, TruthRow
from tests.rig.pair import restless_trace

BEAT, VALUE = Tag("beat", "0x100:0|32"), Tag("value", "0x130:0|32")
CYCLE, PERIOD, TIMEOUT = 0.02, 0.02, 0.2
CYCLES = 3000
FORWARDED_S = 0.0001
"""What a hub needs for a frame that has waited."""


@dataclass(frozen=True)
class Said:
    """A frame of the PLC: when it was said and when it has come, and the cycle that it tells of."""

    said: float
    came: float
    tag: Tag
    cycle: int


def said(rng: random.Random, holdups: bool, lost: float) -> Iterator[Said]:
    """Each cycle's two frames in order: held back now and then, for 0.05 to 2 s, and `lost` of the values' missing."""
    free, next_holdup, missing_until = 0.0, rng.uniform(0.5, 3.0), 0.0
    for cycle in range(CYCLES):
        now = cycle * CYCLE
        if holdups and now >= next_holdup:
            free = now + 0.05 * 40.0 ** rng.random()
            next_holdup = free + rng.uniform(0.5, 3.0)
        if rng.random() < lost:
            missing_until = now + TIMEOUT
        for tag in (BEAT, VALUE):
            if tag is BEAT or now >= missing_until:
                free = max(now, free + FORWARDED_S)
                yield Said(now, free, tag, cycle)


def wrong(seed: int, tolerance: float, *, holdups: bool = False, lost: float = 0.0) -> tuple[int, int]:
    """Of readings that were held for good: how many, and how many of them the judge finds wrong."""
    rng = random.Random(seed)
    reception, rules = Reception(), QualityRules(PERIOD, BEAT.name)
    places = {
        tag.name: reception.listen(MessageRules(key, tag.name), (), TIMEOUT, 0.0)
        for key, tag in enumerate((BEAT, VALUE), start=1)
    }
    keys = {BEAT.name: 1, VALUE.name: 2}
    waiting = sorted(said(rng, holdups, lost), key=lambda one: one.came)
    age, now, good = DeviceAge(), 0.0, []
    while waiting:
        now += PERIOD * rng.uniform(0.9, 1.1)
        while waiting and waiting[0].came <= now:
            one = waiting.pop(0)
            frame = CanFrame(one.came, keys[one.tag.name], False, (one.cycle + 1).to_bytes(4, "little"))
            reception.take(keys[one.tag.name], frame, one.came)
        read = []
        for tag in (BEAT, VALUE):
            channel, slot = places[tag.name]
            missing = reception.absence(channel, slot, now)
            if missing is not None or slot.frame is None:
                read.append(Sample(tag.name, None, missing[0] if missing else Quality.NO_DATA, now))
            else:
                read.append(Sample(tag.name, int.from_bytes(slot.frame.data, "little"), Quality.GOOD, slot.frame.time))
        age, judged = judge(age, (BEAT, VALUE), read, now, rules)
        good += [Sample(one.tag, one.value, one.quality, now, now) for one in judged.values() if one.quality.is_good]
    truth = tuple(
        TruthRow(cycle * CYCLE, cycle * CYCLE, cycle, tag.name, cycle + 1)
        for tag in (BEAT, VALUE)
        for cycle in range(CYCLES)
    )
    run = Run(EmulatorClock(0.0, 0.0), "decanter", None, 0, {})
    return len(good), len(wrong_good(PlcRecording((run,), truth, (), (), (), 0, 0), good, tolerance))


PLAIN = (STALE_PERIODS + 1) * PERIOD
"""What the demonstration's judge allowed on every link."""


@pytest.mark.parametrize("seed", range(5))
def test_what_a_bus_has_held_back_is_not_good_in_the_midst_of_it(seed: int) -> None:
    good, found = wrong(seed, PLAIN, holdups=True)
    assert good > CYCLES and found == 0


def test_a_message_that_is_missing_for_less_than_its_timeout_is_good_and_its_judge_knows_it() -> None:
    assert wrong(0, PLAIN, lost=0.01)[1] > 0, "what shows that the judge has to know it"
    assert wrong(0, PLAIN + TIMEOUT, lost=0.01)[1] == 0


@pytest.mark.parametrize(("link", "least", "most"), [("can", 0.2, 0.45), ("canopen", 0.06, 0.3)])
def test_the_demonstrations_judge_allows_what_the_device_file_does(
    link: str, least: float, most: float, tmp_path: Path
) -> None:
    bus = {"interface": "hub", "channel": str(tmp_path / "can.hub"), "node": 1, "messages": 1}
    held = validity_seconds(setting(tmp_path, link, LINKS[link].settings(tmp_path, {"faces": {link: bus}})))
    assert (min(held.values()), max(held.values())) == (pytest.approx(least), pytest.approx(most))


def test_what_is_asked_for_has_no_such_time(tmp_path: Path) -> None:
    assert validity_seconds(setting(tmp_path, "modbus", {"host": "127.0.0.1", "port": 502})) == {}


def setting(folder: Path, link: str, settings: Mapping[str, object]) -> DemoRun:
    """A demonstration whose plant file is written."""
    name, devices = LINKS[link].device, config_dir() / "devices"
    run = DemoRun(
        folder=folder,
        trace=restless_trace(20.0),
        bearings=(),
        device=devices / "decanter_plc.toml",
        plant=folder / "plant.toml",
        replay=folder / "replay.csv",
        speed=100.0,
        period=2.0,
        notes=(),
        link=link,
        addresses=devices / name if name else None,
    )
    run.plant.write_text(plant_text(link, settings), encoding="utf-8")
    return run


def plant_text(link: str, settings: Mapping[str, object]) -> str:
    rows = "\n".join(f"{key} = {json.dumps(value)}" for key, value in settings.items())
    return f'[[device.links]]\nname = "{link}"\nfile = "device.toml"\n{rows}\n'
