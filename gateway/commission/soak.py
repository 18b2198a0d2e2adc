"""`decanter plc check soak`: scans at their period for a longer time; what they take and lose, which period holds."""

import asyncio
import time
from collections import Counter
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from math import ceil, floor
from pathlib import Path
from typing import Any

from drivers.driver import Complains, Driver
from drivers.errors import DriverError, LinkDown
from drivers.survey import read_plan
from drivers.tag import Quality, Sample
from gateway.commission.files import ScanRecorder
from gateway.commission.options import SharedOptions
from gateway.commission.session import Site, find_period, list_block_words, mention_gateway, perform, require_device
from gateway.console import CommandResult, Part, Progress, Rows, progress
from gateway.repeated import drop_measurements
from gateway.store import percentile

PERIODS_S = (0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0)
"""Periods that are recommended."""
PERIOD_MARGIN = 2.0
"""A recommended period is so many times what 95 % of the scans take, and longer than every single one."""
FIRST_VALUES_S = 3.0
_WAITING = Quality.WAITING_FOR_INITIAL_DATA


@dataclass(slots=True)
class SoakTally:
    """What was counted: the seconds of each scan, the ages (s) of readings, scans with a bad tag, missed ticks.

    `silent` are the scans in which the device was silent about a tag.
    """

    seconds: list[float] = field(default_factory=list)
    ages: list[float] = field(default_factory=list)
    with_bad: int = 0
    all_bad: int = 0
    silent: int = 0
    missed: int = 0
    bad: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    kinds: dict[str, str] = field(default_factory=dict)

    def take(self, samples: Sequence[Sample], begun: float, seconds: float) -> None:
        """One scan, begun at `begun` (s UTC)."""
        bad = [sample for sample in samples if not sample.quality.is_good]
        self.seconds.append(seconds)
        self.with_bad += bool(bad)
        self.all_bad += len(bad) == len(samples)
        self.silent += any(sample.quality is Quality.TIMEOUT for sample in bad)
        self.bad.update(sample.tag for sample in bad)
        # A reason with a value in it is another one in each scan: the first of its kind stands for all.
        self.reasons.update({self.kinds.setdefault(drop_measurements(sample.reason), sample.reason) for sample in bad})
        self.ages += [max(0.0, begun + seconds - sample.time) for sample in samples if sample.quality.is_good]


async def soak_device(
    site: Site, duration: float, given_period: float | None, record: Path | None, progress: Progress
) -> CommandResult:
    """Scan for `duration` seconds. A failed check where scans were lost or do not fit. Ctrl-C gives what there is."""
    device, period = require_device(site), find_period(site, given_period)
    mention_gateway(site)
    recorder = ScanRecorder(record, device.tags) if record is not None else None
    tally, before = SoakTally(), {}
    try:
        async with _open_driver(site) as driver:
            try:
                # A device that speaks by itself is heard out once before anything is counted.
                until = time.monotonic() + FIRST_VALUES_S
                while site.target.capabilities.speaks and time.monotonic() < until:
                    if all(sample.quality is not _WAITING for sample in await driver.read(device.tags)):
                        break
                    await asyncio.sleep(0.02)
                before = dict(driver.statistics())
                # Scans on absolute deadlines, as the gateway has them: ticks that pass meanwhile are missed, not late.
                begin, tick = time.monotonic(), 0
                while (now := time.monotonic()) - begin < duration:
                    wall = time.time()
                    samples = await driver.read(device.tags)
                    took = time.monotonic() - now
                    tally.take(samples, wall, took)
                    if recorder is not None:
                        recorder.take(wall + took, samples)
                    done = min(1.0, (now - begin) / duration)
                    progress(f"{len(tally.seconds)} scans, {tally.with_bad} with bad tags", done)
                    following = max(tick + 1, floor((time.monotonic() - begin) / period) + 1)
                    tally.missed += following - tick - 1
                    tick = following
                    await asyncio.sleep(max(0.0, min(begin + tick * period, begin + duration) - time.monotonic()))
            except asyncio.CancelledError:  # Ctrl-C: asyncio.run cancels the task, and what was counted is shown
                site.notes.append("stopped before its time")
            finally:
                counted = dict(driver.statistics())
                site.count(counted)
    finally:
        if recorder is not None:
            recorder.close()
    since = {name: counted[name] - before.get(name, 0) for name in counted}
    return _summary(site, tally, period, since, record)


@asynccontextmanager
async def _open_driver(site: Site) -> AsyncIterator[Driver]:
    """The driver with a connection; one on a bus has FIRST_VALUES_S to hear its device. Raises DriverError."""
    driver = site.target.make_driver()
    try:
        try:
            await driver.open()
        except DriverError as error:
            until = time.monotonic() + FIRST_VALUES_S
            while site.target.capabilities.speaks and not driver.connected and time.monotonic() < until:
                await asyncio.sleep(0.02)
            if not driver.connected:
                # What the device says of itself tells more, where it is heard and cannot be used: a node that no master
                # has started.
                complaints = driver.complaints() if isinstance(driver, Complains) else ()
                if not complaints or str(error) in complaints:
                    raise
                remedy = "start it at its master, or let this program do it (--set configure=true)"
                raise LinkDown(f"{complaints[0]}: {remedy}") from None
        yield driver
    finally:
        await driver.close()


def _summary(
    site: Site, tally: SoakTally, period: float, counted: Mapping[str, float], record: Path | None
) -> CommandResult:
    seconds, scans = tally.seconds, len(tally.seconds)
    if not seconds:
        return CommandResult({"scans": 0}, "no scan was finished; give a longer --seconds")
    # A cycle with the write-back is longer than a scan, by the number of its requests.
    plan = read_plan(site.target.driver, site.target.settings, site.target.tags, list_block_words(site))
    factor = 1.0 if plan is None or not plan.requests else 1.0 + len(plan.writes) / len(plan.requests)
    data: dict[str, Any] = {
        "scans": scans,
        "period_s": period,
        "missed": tally.missed,
        "scan_ms": {name: 1e3 * percentile(seconds, share) for name, share in _SHARES.items()},
        "scans_with_bad": tally.with_bad,
        "bad_tags": dict(tally.bad.most_common()),
        "reasons": dict(tally.reasons.most_common(10)),
        "timeouts": int(counted.get("timeouts", 0)),
        "mismatches": int(counted.get("mismatches", 0)),
        "reconnects": int(counted.get("reconnects", 0)),
        "recommended_period_s": recommend_period(seconds, factor),
        "recording": str(record) if record is not None else None,
    }
    if site.target.capabilities.speaks:
        ages = {name: 1e3 * percentile(tally.ages, share) for name, share in _SHARES.items()} if tally.ages else None
        data["age_ms"], data["recommended_period_s"] = ages, None
        site.notes.append("this device speaks by itself: a scan takes what it has said, so that what counts is its age")
    complaint = ""  # the worst alone: missed ticks follow from a device that does not answer
    if tally.all_bad == scans:
        complaint = f"no scan had a good reading: {tally.reasons.most_common(1)[0][0]}"
    elif tally.with_bad:
        tag, times = tally.bad.most_common(1)[0]
        complaint = f"{tally.with_bad} of {scans} scans had a tag that was not good, mostly {tag} ({times} times)"
    elif tally.missed:
        complaint = f"{tally.missed} ticks were missed in {scans} scans: the period is too short for this device"
    if complaint and (cure := _cure_of_silence(site, tally, counted)):
        complaint, data["recommended_period_s"] = f"{complaint}; {cure}", None
    return CommandResult(data, complaint)


def _cure_of_silence(site: Site, tally: SoakTally, counted: Mapping[str, float]) -> str:
    """What is to be done where the device was silent; "" where it never was. A longer period brings no reply sooner."""
    if not tally.silent:
        return ""
    timeout = site.target.settings.get("timeout")
    within = f"the timeout of {timeout:g} s" if isinstance(timeout, int | float) else "the timeout"
    proposal = " (`decanter plc probe` proposes one)" if site.target.capabilities.registers else ""
    # A reply to a question that was given up already is dropped as foreign: it did come, too late.
    if counted.get("foreign_replies", 0):
        return f"replies came after {within}: give a longer one in [device]{proposal}"
    asked = int(counted.get("timeouts", 0))
    if not asked:
        return f"it was silent in {tally.silent} scans: does its program stand still? A longer period does not help"
    return (
        f"{asked} requests had no reply within {within}: is the device slower than that, and needs a longer one"
        f"{proposal}, or does its program stand still? A longer period does not help"
    )


_SHARES = {"p50": 0.5, "p95": 0.95, "max": 1.0}


def recommend_period(seconds: Sequence[float], factor: float = 1.0) -> float:
    """The least usual period that leaves as much time again as 95 % of the scans take, and holds the longest one.

    `factor` is what a cycle takes beside the scan. Beyond the table it is whole minutes.
    """
    needed = factor * max(PERIOD_MARGIN * percentile(list(seconds), 0.95), max(seconds))
    return next((period for period in PERIODS_S if period >= needed), 60.0 * ceil(needed / 60.0))


def soak(given: SharedOptions, seconds: float, period: float | None, record: Path | None) -> None:
    """Carry out `decanter plc check soak`; its options and its help are in commission/commands.py."""

    async def work(site: Site) -> CommandResult:
        with progress("soak") as report:
            return await soak_device(site, seconds, period, record, report)

    arguments = {"seconds": seconds, "period": period, "record": record and str(record)}
    perform(given, "soak", arguments, work, _view)


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    if not data["scans"]:
        return
    kinds = (("scan", "scan_ms"), ("age of a reading", "age_ms"))
    rows = [(name, *data[key].values()) for name, key in kinds if data.get(key)]
    yield f"{data['scans']} scans every {data['period_s']:g} s, {data['missed']} ticks missed"
    yield Rows("", ("ms", "p50", "p95", "max"), rows)
    counts = f"{data['timeouts']} timeouts, {data['mismatches']} wrong replies, {data['reconnects']} reconnections"
    yield f"{data['scans_with_bad']} scans had a tag that was not good; {counts}"
    yield from (f"  {tag}: {times} times" for tag, times in list(data["bad_tags"].items())[:10])
    yield from (f"  {times} x {reason}" for reason, times in data["reasons"].items())
    if data["recommended_period_s"]:
        yield f"recommended period: {data['recommended_period_s']:g} s or longer"
    if data["recording"]:
        yield f"recording: {data['recording']}"
