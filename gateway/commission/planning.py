"""`plan` at work: the requests of one scan, and their longest time against the period; nothing is sent."""

from dataclasses import asdict
from math import ceil
from typing import Any

from drivers.driver import Explains
from drivers.survey import ReadPlan, read_plan
from drivers.tag import Tag
from gateway.commission.outcome import Outcome, Site
from gateway.commission.survey.addresses import parse_register, reference_of
from gateway.settings.devices import DeviceMap

PERIOD_S = 1.0
"""Without a plant file."""


def period_of(site: Site, given: float | None = None) -> float:
    """The period (s) that was given, else the plant file's, else a second."""
    if given is not None:
        return given
    return site.target.config.scan.period if site.target.config is not None else PERIOD_S


def device_of(site: Site) -> DeviceMap:
    """The device file. Raises ValueError where there is none."""
    if site.target.map is None:
        raise ValueError("which tags? Give the plant file (--config FILE) or the device file (--device FILE)")
    return site.target.map


def words_of(site: Site) -> tuple[Tag, ...]:
    """The words of the block, where something may be written."""
    layout = device_of(site).writeback
    config = site.target.config
    return () if layout is None or (config is not None and config.writeback.mode == "off") else layout.words


async def plan(site: Site, given_period: float | None) -> Outcome:
    """The plan of a scan. A failed check where a tag cannot be read or the worst case is longer than the period."""
    device, period = device_of(site), period_of(site, given_period)
    found = read_plan(site.target.driver, site.target.settings, device.tags, words_of(site))
    if found is None:
        return _by_sentences(site, device, period)
    total = found.seconds + found.write_seconds
    data: dict[str, Any] = {
        "requests": [{**asdict(one), "reference": _reference(one.place, one.count)} for one in found.requests],
        "writes": [{**asdict(one), "reference": _reference(one.place, one.count)} for one in found.writes],
        "registers": sum(one.count for one in found.requests),
        "in_vain": sum(one.vain for one in found.requests),
        "tags": len(device.tags),
        "worst_read_s": found.seconds,
        "worst_write_s": found.write_seconds,
        "worst_cycle_s": total,
        "period_s": period,
        "problems": [*found.problems, *found.overlaps],
    }
    complaint = _complaint(site, found, period)
    return Outcome(data, int(bool(complaint)), complaint)


def _complaint(site: Site, found: ReadPlan, period: float) -> str:
    problems = [*found.problems, *found.overlaps]
    if problems:
        return f"{len(problems)} things stand in the way, the first: {problems[0]}"
    total = found.seconds + found.write_seconds
    longer = f"longer than the period of {period:g} s: ticks are missed while replies are late"
    if total <= period:
        return ""
    if found.seconds <= period:
        site.notes.append(f"with the write-back a cycle can take {total:.3g} s, {longer}")
        return ""
    count = len(found.requests)
    shorter = f", or timeout to {_down(period / count):g} s if the device is fast enough (see soak)"
    return (
        f"a scan of {count} requests can take {found.seconds:.3g} s, {longer}; set scan.period to "
        f"{ceil(10 * total) / 10:g} s{shorter if 'timeout' in site.target.settings else ''}"
    )


def _down(seconds: float) -> float:
    return int(1000 * seconds) // 10 / 100


def _reference(place: str, count: int) -> str:
    first = reference_of(place)
    return f"{first}-{parse_register(place).moved(count - 1).reference}" if first and count > 1 else first


def _by_sentences(site: Site, device: DeviceMap, period: float) -> Outcome:
    """A device that is not read in requests of its own: what its driver says of the plan."""
    driver = site.target.make_driver()
    said = list(driver.explain(device.tags)) if isinstance(driver, Explains) else []
    names = tuple(f"{tag.name}: " for tag in device.tags)
    problems = [line for line in said if line.startswith(names)]
    if not said:
        said = [f"the driver {site.target.driver!r} has no plan to show"]
    if site.target.capabilities.speaks:
        site.notes.append(
            "this device speaks by itself: a scan takes what it has said, and asks only for what is listed so"
        )
    data = {"sentences": said, "tags": len(device.tags), "period_s": period, "problems": problems}
    complaint = f"{len(problems)} tags cannot be read, the first: {problems[0]}" if problems else ""
    return Outcome(data, int(bool(problems)), complaint)
