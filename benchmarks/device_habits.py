"""Devices with two or three habits at once, as the tests draw them, over each link that can have them: what is read.

`python -m benchmarks.device_habits [--combinations N] [--json]`. A gateway's scan a tenth of a second: eight registers
are read, then a block of two is written once. A register that is not written holds another number in each answer, so
that a good reading is held against what the device told between the sample's two moments. A share of readings is of
those that the device does not refuse for ever; "at last" is the last quarter of the scans, when what was looked for is
found. A block is accepted where the device holds it and the driver says so; held and not said counts apart, said and
not held is wrong. Time is virtual (`benchmarks.virtual_time`), but for the serial port, whose kernel has its own: where
this process stood still for longer than an answer may take there, its devices were later than they say, and a good
reading may be an older one. The habits' table and the device are those of the tests (`tests/rig/device_habits.py`,
`habit_wires.py`).
"""

import asyncio
import random
import tempfile
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import click

from benchmarks.figures import Figure, give, percentile
from benchmarks.virtual_time import virtual_loop
from drivers.errors import DriverError
from drivers.modbus.driver import ModbusDriver
from drivers.tag import Sample
from tests.rig.device_habits import PTY
from tests.rig.habit_wires import LINKS, MOVING, TAGS, WALKED, WRITTEN, Habit, Together, draw_habits, driven

PERIOD_S = 0.1
TOGETHER = 6
"""So many devices are read at a time where time is real: they wait more than they work."""
LONGEST_S = 30.0
"""A device costs no more than this, whatever it does."""
POOR_SHARE = 0.9
_TICK_S = 0.02


@dataclass
class Tally:
    """What was read of one device, or of several."""

    devices: int = 0
    due: int = 0
    good: int = 0
    due_late: int = 0
    good_late: int = 0
    wrong: int = 0
    blocks: int = 0
    accepted: int = 0
    held_unsaid: int = 0
    said_unheld: int = 0
    first_s: list[float] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)

    def note_scan(self, samples: list[Sample], wrong: int, lost: set[int], *, late: bool) -> None:
        """Count one scan's readings."""
        kept = [sample for place, sample in enumerate(samples) if place not in lost]
        good = sum(sample.quality.is_good for sample in kept)
        self.due, self.good, self.wrong = self.due + len(kept), self.good + good, self.wrong + wrong
        if late:
            self.due_late, self.good_late = self.due_late + len(kept), self.good_late + good
            self.reasons.update(sample.reason for sample in kept if not sample.quality.is_good)

    def figures(self, name: str) -> list[Figure]:
        """Its shares (per cent) and times."""
        first = [value for value in self.first_s if value < LONGEST_S]
        return [
            Figure(f"{name}: devices", self.devices, "", "of which ever read", len(first)),
            Figure(f"{name}: good readings", _share(self.good, self.due), "%", "at last", self.share_late),
            Figure(f"{name}: wrong and GOOD", self.wrong, ""),
            Figure(f"{name}: blocks accepted", _share(self.accepted, self.blocks), "%"),
            Figure(f"{name}: held, not said", _share(self.held_unsaid, self.blocks), "%"),
            Figure(f"{name}: said and not held", self.said_unheld, ""),
            *([Figure(f"{name}: first good, p50", percentile(first, 50), "s", "longest", max(first))] if first else []),
        ]

    @property
    def share_late(self) -> float:
        """Good readings of the last scans (per cent)."""
        return _share(self.good_late, self.due_late)


def _share(part: int, whole: int) -> float:
    return 100 * part / whole if whole else 0.0


def total(tallies: Iterable[Tally]) -> Tally:
    """Several devices' together."""
    whole = Tally()
    for one in tallies:
        for name in ("devices", "due", "good", "due_late", "good_late", "wrong", "blocks", "accepted"):
            setattr(whole, name, getattr(whole, name) + getattr(one, name))
        whole.held_unsaid += one.held_unsaid
        whole.said_unheld += one.said_unheld
        whole.first_s += one.first_s or [LONGEST_S]
        whole.reasons += one.reasons
    return whole


def wrong_values(habit: Habit, samples: list[Sample], written: set[int]) -> int:
    """Good readings that are not what the device told in their time."""
    wrong = 0
    for place, sample in enumerate(samples):
        if not sample.quality.is_good or sample.sent is None:
            continue
        value = int(sample.value) if isinstance(sample.value, int | float) else -1
        ours = habit.held(place, value, sample.sent, sample.time) if place in MOVING else value in {place} | written
        wrong += not ours
    return wrong


async def scan(together: Together, link: str, scans: int, folder: Path) -> Tally:
    """Read one device, and write to it, as often as said."""
    habit, tally, loop = together.device(link, moving=True), Tally(devices=1), asyncio.get_running_loop()
    lost, written, begin = together.lost(habit), set[int](), loop.time()

    async def once(driver: ModbusDriver, number: int) -> None:
        samples = await driver.read(TAGS)
        if not tally.first_s and any(sample.quality.is_good for sample in samples):
            tally.first_s.append(loop.time() - begin)
        tally.note_scan(samples, wrong_values(habit, samples, written), lost, late=number >= scans * 3 // 4)
        values = [1000 + 2 * number, 1001 + 2 * number]
        written.update(values)
        said = False
        with suppress(DriverError):
            await driver.write(list(zip(WRITTEN, values, strict=True)))
            said = True
        holds = [habit.registers[0], habit.registers[1]] == values
        tally.blocks += 1
        tally.accepted += said and holds
        tally.held_unsaid += holds and not said
        tally.said_unheld += said and not holds

    with suppress(TimeoutError):
        async with asyncio.timeout(LONGEST_S), driven(habit, link, folder, **together.settings(link)) as driver:
            for number in range(scans):
                await once(driver, number)
                await asyncio.sleep(PERIOD_S)
    return tally


async def _note_pauses(pauses: list[float]) -> None:
    """Add by how much each wait was longer than it was to be (s), until it is cancelled."""
    loop = asyncio.get_running_loop()
    while True:
        begin = loop.time()
        await asyncio.sleep(_TICK_S)
        pauses.append(loop.time() - begin - _TICK_S)


async def walk(
    drawn: list[Together], link: str, scans: int, folder: Path, pauses: list[float]
) -> dict[tuple[int, str], Tally]:
    """Each combination that there is over the link; `pauses` takes how long the process stood still."""
    gate = asyncio.Semaphore(TOGETHER if link == PTY else len(drawn))

    async def one(together: Together) -> Tally:
        async with gate:
            return await scan(together, link, scans, folder)

    numbers = [number for number, together in enumerate(drawn) if link in together.links]
    noting = asyncio.ensure_future(_note_pauses(pauses))
    done = await asyncio.gather(*(one(drawn[number]) for number in numbers))
    noting.cancel()
    return {(number, link): tally for number, tally in zip(numbers, done, strict=True)}


@click.command()
@click.option("--combinations", type=click.IntRange(1), default=200, show_default=True, help="How many are drawn.")
@click.option("--scans", type=click.IntRange(2), default=20, show_default=True, help="Of each device.")
@click.option("--quick", is_flag=True, help="6 combinations of 4 scans.")
@click.option("--seed", default=39, show_default=True, help="The same combinations for the same number.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
def main(*, combinations: int, scans: int, quick: bool, seed: int, as_json: bool) -> None:
    """Read devices that have several habits at once, over each link."""
    rng = random.Random(seed)
    combinations, scans = (6, 4) if quick else (combinations, scans)
    drawn = [draw_habits(rng) for _ in range(combinations)]
    tallies: dict[tuple[int, str], Tally] = {}
    pauses: dict[str, list[float]] = {link: [0.0] for link in LINKS}
    with tempfile.TemporaryDirectory() as folder:
        for link in LINKS:
            with asyncio.Runner(loop_factory=None if link == PTY else virtual_loop) as runner:
                tallies |= runner.run(walk(drawn, link, scans, Path(folder), pauses[link]))
    figures: list[Figure] = []
    for link in LINKS:
        figures += total(tally for (_, over), tally in tallies.items() if over == link).figures(link)
    latest = Together(()).settings(PTY)["longest_reply"]
    figures.append(Figure(f"{PTY}: this process stood still", max(pauses[PTY]), "s", "an answer may take", latest))
    for row in WALKED:
        theirs = total(tally for (number, _), tally in tallies.items() if row in drawn[number].rows)
        if theirs.devices:
            blocks = _share(theirs.accepted, theirs.blocks)
            figures.append(Figure(f"{row.habit}: good at last", theirs.share_late, "%", "blocks accepted", blocks))
    for (number, link), tally in tallies.items():
        if not as_json and tally.share_late < 100 * POOR_SHARE:
            habits = ", ".join(str(dict(row.wire)) for row in drawn[number].rows)
            why = "; ".join(f"{count}x {reason}" for reason, count in tally.reasons.most_common(2))
            click.echo(f"{link}: {tally.share_late:.0f} %: {habits}: {why}", err=True)
    give("habits together", figures, as_json=as_json)


if __name__ == "__main__":
    main()
