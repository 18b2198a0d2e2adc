"""`decanter plc check`: files, places, model, contract; then every tag read once, and the heartbeat twice."""

import asyncio
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import click

from drivers.driver import Cautions
from drivers.errors import DriverError
from drivers.settings import ConfigError
from drivers.survey import read_plan
from drivers.tag import Quality, Sample
from gateway.commission.read import read_raw
from gateway.commission.session import (
    CheckStep,
    CommandResult,
    SharedOptions,
    Site,
    device_of,
    failed,
    link_options,
    make_target,
    ok,
    perform,
    period_of,
    show_steps,
    verdict,
    warning,
    words_of,
)
from gateway.commission.writeback.write_plan import problems_of
from gateway.entry import Exit, exit_code
from gateway.machine.model import load_model
from gateway.settings import load_secrets

_SAYS_SO = frozenset({Quality.NO_DATA, Quality.SENSOR_FAILURE})
_DEAD = frozenset({Quality.NOT_CONNECTED, Quality.COMMUNICATION_ERROR, Quality.NO_COMMUNICATION, Quality.TIMEOUT})


async def check_configuration(sites: Mapping[str, Site], *, offline: bool) -> CommandResult:
    """Every step, each with its sentence; with `offline` no device is asked.

    `sites` are the device over each of its links, by the links' names.
    """
    first = next(iter(sites.values()))
    steps = [*_files(first), *_model(first), *_contract(first), *_messages(first)]
    rows: list[dict[str, Any]] = []
    absent: list[DriverError] = []
    for name, site in sites.items():
        own = _places(site)
        if not offline and steps[0].state != "failed":
            try:
                rows += [{"link": name, **row} for row in await _readings(site, own)]
            except DriverError as error:
                absent.append(error)
                own.append(failed("reading", str(error)))
                gone = {"value": None, "quality": Quality.NOT_CONNECTED.name, "reason": str(error)}
                rows += [{"link": name, "tag": tag.name, **gone} for tag in site.target.tags]
        of_link = f"link {name!r}: " if len(sites) > 1 else ""
        steps += [replace(step, sentence=of_link + step.sentence) for step in own]
    code, complaint = verdict(steps)
    if len(absent) == len(sites):
        # The device's absence is said rather than what fails because of it.
        code = exit_code(absent[0])
        complaint = f"{absent[0]}; is the PLC there? Give --host and --port, or start one: decanter emulate"
    warnings = [step.sentence for step in steps if step.state == "warning"]
    data = {
        "links": {name: site.target.place for name, site in sites.items()},
        "tags": len(device_of(first).tags),
        "steps": [step.plain() for step in steps],
        "readings": rows,
        "open_points": warnings,
    }
    return CommandResult(data, code, complaint)


def _files(site: Site) -> list[CheckStep]:
    device, config = device_of(site), site.target.config
    named = f"{config.path} and {device.path}" if config else str(device.path)
    try:
        driver = site.target.make_driver(words_of(site))
    except DriverError as error:
        return [failed("files", f"{device.path}: device: {error}")]
    steps = [
        ok("files", f"{named} {'are' if config else 'is'} in order: {len(device.tags)} tags, driver {device.driver}")
    ]
    if isinstance(driver, Cautions):
        steps += [warning("cautions", caution) for caution in driver.cautions()]
    return steps


def _messages(site: Site) -> list[CheckStep]:
    """Whether who is to be told of alarms can be: the file of secrets; nothing is sent."""
    config = site.target.config
    if config is None or not config.notify.to:
        return []
    try:
        load_secrets(config.notify)
    except ConfigError as error:
        return [failed("messages", problem) for problem in error.problems]
    return [ok("messages", f"alarms are told to {', '.join(row.name for row in config.notify.to)}")]


def _places(site: Site) -> list[CheckStep]:
    """Addresses that cannot be, tags that share registers, a block too long for one write."""
    device = device_of(site)
    plan = read_plan(site.target.driver, site.target.settings, device.tags, words_of(site))
    if plan is None:
        return []
    problems = (*plan.problems, *plan.overlaps)
    if problems:
        return [failed("places", problem) for problem in problems]
    count = sum(request.count for request in plan.requests)
    return [ok("places", f"{len(plan.requests)} requests for {count} addresses; none is used twice")]


def _model(site: Site) -> list[CheckStep]:
    """The model, and that the plant has what it reads."""
    config = site.target.config
    if config is None:
        return [warning("model", "only the device file was given (--device): the model is not checked")]
    if config.model.path is None:
        return [warning("model", "model.path is not set: the gateway watches the limit and predicts nothing")]
    try:
        loaded = load_model(config)
    except ValueError as error:
        return [failed("model", str(error))]
    if loaded is None:
        return []
    sentence = f"{loaded.model.sha.name} ({loaded.hash[:12]}) predicts {config.model.temperature}"
    return [warning("model", f"{sentence}; {loaded.warning}") if loaded.warning else ok("model", sentence)]


def _contract(site: Site) -> list[CheckStep]:
    """What writing needs, unless nothing is to be written."""
    device, config = device_of(site), site.target.config
    if not device.writebacks or (config is not None and config.writeback.mode == "off"):
        return [ok("write-back", "off: nothing is written")]
    problems = list(problems_of(site, device))
    if problems:
        return [warning("write-back", problem) for problem in problems]
    return [
        ok(
            "write-back",
            f"{f'{layout.temperature}: ' if layout.temperature else ''}{len(layout.words)} words from "
            f"{layout.words[0].address}, layout version {layout.version}",
        )
        for layout in device.writebacks
    ]


# ---------------------------------------------------------------- the device


async def _readings(site: Site, steps: list[CheckStep]) -> list[dict[str, Any]]:
    device = device_of(site)
    raws = await read_raw(site, device.tags)
    samples = [raw.sample for raw in raws]
    bad = [sample for sample in samples if not sample.quality.is_good]
    if bad and len(bad) == len(samples):
        first = bad[0]
        code = Exit.CANNOT_CONNECT if first.quality in _DEAD else Exit.DEVICE_EXCEPTION
        code = Exit.TIMEOUT if first.quality is Quality.TIMEOUT else code
        steps.append(CheckStep("reading", "failed", f"no tag can be read: {first.reason}", code))
    # Where nothing at all can be read one sentence says so, instead of one a tag.
    for sample in bad if len(bad) < len(samples) else ():
        # A sensor that is off says so in the right place: that is no fault of the configuration.
        report = warning if sample.quality in _SAYS_SO else failed
        steps.append(report("reading", f"{sample.tag} is {sample.quality.name}: {sample.reason}"))
    if not bad:
        steps.append(ok("reading", f"all {len(samples)} tags are good"))
    if len(bad) < len(samples):
        steps += await _heartbeat(site, samples)
    return [
        {"tag": sample.tag, "value": sample.value, "quality": sample.quality.name, "reason": sample.reason}
        for sample in samples
    ]


async def _heartbeat(site: Site, before: Sequence[Sample]) -> list[CheckStep]:
    """Whether the PLC's program counts, within the time that the configuration gives it."""
    device, config = device_of(site), site.target.config
    if device.heartbeat is None:
        sentence = (
            "no heartbeat is named: a program that stands still cannot be told from one at rest (bind --heartbeat TAG)"
        )
        return [warning("heartbeat", sentence)]
    first = next(sample.value for sample in before if sample.tag == device.heartbeat)
    if first == 0:
        return [failed("heartbeat", f"{device.heartbeat} is 0: the PLC's program does not run")]
    patience = max(config.device.heartbeat_period if config else 0.0, period_of(site))
    begun = time.monotonic()
    tag = device.by_name[device.heartbeat]
    # Asked five times within its patience: a program that counts fast may stand at the same number at one moment.
    while (left := patience - (time.monotonic() - begun)) > 0:
        await asyncio.sleep(min(left, patience / 5))
        now = (await read_raw(site, [tag]))[0].sample
        if now.value not in (first, None):
            took = time.monotonic() - begun
            return [ok("heartbeat", f"{device.heartbeat} went from {first} to {now.value} within {took:.2g} s")]
    return [failed("heartbeat", f"{device.heartbeat} stood at {first} for {patience:g} s: does the program run?")]


@click.command(short_help="Check the configuration, and with the device every tag of it.")
@click.option("--offline", is_flag=True, help="Only what can be checked without the device.")
@link_options
def check(given: SharedOptions, offline: bool) -> None:
    """Check files, places, limits, model and write-back contract; then read every tag, and see the heartbeat move."""

    async def work(site: Site) -> CommandResult:
        sites = {site.target.kind: site}
        if site.target.config is not None and given.link is None:
            links = site.target.config.links
            others = {
                link.name: replace(site, target=make_target(given.plant, link=link.name, machine=given.machine))
                for link in links[1:]
            }
            sites = {links[0].name: site, **others}
        return await check_configuration(sites, offline=offline)

    perform(given, "check", {"offline": offline}, work, show_steps)
