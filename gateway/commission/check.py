"""`decanter plc check`: files, places, model, contract; then every tag read once, and the heartbeat twice."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import isinf
from typing import TYPE_CHECKING, Any

import click

from drivers.driver import Cautions
from drivers.errors import DriverError
from drivers.survey import read_plan
from drivers.tag import Quality, Sample
from gateway.clock_sync import clock_error
from gateway.commission.options import SharedOptions
from gateway.commission.read import read_raw
from gateway.commission.session import (
    CheckStep,
    Site,
    conclude_steps,
    failed_step,
    find_period,
    list_block_words,
    make_target,
    ok,
    perform,
    require_device,
    step_lines,
    warning,
)
from gateway.commission.writeback.write_plan import writing_problems
from gateway.console import CommandResult, Line, Part
from gateway.entry import Exit, exit_code, sentences
from gateway.settings import Config, load_plant

if TYPE_CHECKING:
    from gateway.machine.model import LoadedModel, ModelsAtStart

_SAYS_SO = frozenset({Quality.NO_DATA, Quality.SENSOR_FAILURE})
_DEAD = frozenset({Quality.NOT_CONNECTED, Quality.COMMUNICATION_ERROR, Quality.NO_COMMUNICATION, Quality.TIMEOUT})


async def check_configuration(sites: Mapping[str, Site], *, offline: bool) -> CommandResult:
    """Every step, each with its sentence; with `offline` no device is asked.

    `sites` are the device over each of its links, by the links' names.
    """
    first = next(iter(sites.values()))
    config, steps = first.target.config, _files(first)
    if config is None:
        steps.append(warning("model", "only the device file was given (--device): the model is not checked"))
        steps += _contract(first)
    else:
        from gateway.machine.model import models_at_start  # loads what runs a model, which a device alone needs not

        models = models_at_start(config)
        steps += [*_models(config, models), *_contract(first), *_finding_steps(config, models), *_clock()]
    rows: list[dict[str, Any]] = []
    absent: list[DriverError] = []
    for name, site in sites.items():
        own = _places(site)
        if not offline and steps[0].state != "failed":
            try:
                rows += [{"link": name, **row} for row in await _readings(site, own)]
            except DriverError as error:
                absent.append(error)
                own.append(failed_step("reading", str(error)))
                gone = {"value": None, "quality": Quality.NOT_CONNECTED.name, "reason": str(error)}
                rows += [{"link": name, "tag": tag.name, **gone} for tag in site.target.tags]
        of_link = f"link {name!r}: " if len(sites) > 1 else ""
        steps += [replace(step, sentence=of_link + step.sentence) for step in own]
    result = conclude_steps(
        steps,
        links={name: site.target.place for name, site in sites.items()},
        tags=len(require_device(first).tags),
        readings=rows,
        open_points=[step.sentence for step in steps if step.state == "warning"],
    )
    if len(absent) < len(sites):
        return result
    # The device's absence is said rather than what fails because of it.
    sentence = f"{absent[0]}; is the PLC there? Give --host HOST:PORT, or start one: decanter emulate"
    return CommandResult(result.data, sentence, exit_code(absent[0]))


def _files(site: Site) -> list[CheckStep]:
    device, config = require_device(site), site.target.config
    named = f"{config.path} and {device.path}" if config else str(device.path)
    try:
        driver = site.target.make_driver(list_block_words(site))
    except DriverError as error:
        return [failed_step("files", f"{device.path}: device: {error}")]
    steps = [
        ok("files", f"{named} {'are' if config else 'is'} in order: {len(device.tags)} tags, driver {device.driver}")
    ]
    if isinstance(driver, Cautions):
        steps += [warning("cautions", caution) for caution in driver.cautions()]
    return steps


def _finding_steps(config: Config, models: ModelsAtStart) -> list[CheckStep]:
    """What the judge of the plant file finds beside what has a step of its own."""
    from gateway.plant import check_common, check_machine

    found = [one for one in check_machine(config, models) if one.part != "model"]
    found += check_common(config) if config.leads else []
    steps = [(failed_step if finding.grave else warning)(finding.part, finding.sentence) for finding in found]
    return steps + [step for step in _recipient_steps(config) if step.name not in {one.part for one in found}]


def _recipient_steps(config: Config) -> list[CheckStep]:
    """Who is told of alarms and of what is on record; nothing is sent."""
    steps = []
    if config.notify.to:
        steps.append(ok("messages", f"alarms are told to {', '.join(row.name for row in config.notify.to)}"))
    if config.northbound.enabled:
        names = [row.name for row in config.northbound.sinks]
        names += ["Prometheus"] if config.northbound.metrics.port is not None else []
        names += ["OPC UA's clients"] if config.northbound.opcua.port is not None else []
        steps.append(ok("northbound", f"what is on record is told to {', '.join(names)}"))
    return steps


def _clock() -> list[CheckStep]:
    """Whether somebody steers this computer's clock, by which a plant's records are dated."""
    error = clock_error()
    if error is None:
        return []
    if isinf(error):
        return [
            warning("clock", "no time server steers this computer's clock: set up NTP (timedatectl says how it is)")
        ]
    return [ok("clock", f"steered by a time server, wrong by {1e3 * error:.0f} ms at most")]


def _places(site: Site) -> list[CheckStep]:
    """Addresses that cannot be, tags that share registers, a block too long for one write."""
    device = require_device(site)
    plan = read_plan(site.target.driver, site.target.settings, device.tags, list_block_words(site))
    if plan is None:
        return []
    problems = (*plan.problems, *plan.overlaps)
    if problems:
        return [failed_step("places", problem) for problem in problems]
    count = sum(request.count for request in plan.requests)
    places = ok("places", f"{len(plan.requests)} requests for {count} addresses; none is used twice")
    return [places, *(warning("places", caution) for caution in plan.cautions)]


def _models(config: Config, models: ModelsAtStart) -> list[CheckStep]:
    """The models of each predicted temperature, and that the plant has what they read."""
    if all(one.model.path is None for one in config.temperature_configs):
        key = "no temperature has a model" if len(config.temperature_configs) > 1 else "model.path is not set"
        return [warning("model", f"{key}: the gateway watches the limit and predicts nothing")]
    loaded, problem = models
    steps = [failed_step("model", problem)] if problem else []
    for one, (first, members) in zip(config.temperature_configs, loaded, strict=True):
        if one.model.path is None:
            steps.append(warning("model", f"{one.model.temperature} has no model: it is watched and not predicted"))
        steps += [_judge_model(model, one.model.temperature) for model in (first, *members) if model is not None]
    return steps


def _judge_model(loaded: LoadedModel, tag: str) -> CheckStep:
    """One model, and whether it may be used."""
    model, verdict = loaded.model, loaded.verdict
    machine = model.provenance.settings.get("machine")
    own = f", with what it knows of the machine {machine}" if machine else ""
    own = f", as a new machine of the type of {', '.join(model.machines)}" if model.machines else own
    parts = [f"{model.sha.name} ({loaded.hash[:12]}) predicts {tag}{own}"]
    parts += [] if verdict is None else [f"it is {verdict.sentence}"]
    parts += [loaded.warning] if loaded.warning else []
    if verdict is not None and verdict.word == "unfit":
        return failed_step("model", "; ".join(parts))
    limited = loaded.warning or (verdict is not None and verdict.word != "fit")
    return (warning if limited else ok)("model", "; ".join(parts))


def _contract(site: Site) -> list[CheckStep]:
    """What writing needs, unless nothing is to be written."""
    device, config = require_device(site), site.target.config
    if not device.writebacks or (config is not None and config.writeback.mode == "off"):
        return [ok("write-back", "off: nothing is written")]
    problems = list(writing_problems(site, device))
    if problems:
        return [warning("write-back", problem) for problem in problems]
    plan = read_plan(site.target.driver, site.target.settings, device.tags, device.block_words)
    by = f"; by {plan.written_by}" if plan is not None and plan.written_by else ""
    return [
        ok(
            "write-back",
            f"{f'{layout.temperature}: ' if layout.temperature else ''}{len(layout.words)} words from "
            f"{layout.words[0].address}, layout version {layout.version}{by}",
        )
        for layout in device.writebacks
    ]


# ---------------------------------------------------------------- the device


async def _readings(site: Site, steps: list[CheckStep]) -> list[dict[str, Any]]:
    device = require_device(site)
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
        report = warning if sample.quality in _SAYS_SO else failed_step
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
    device, config = require_device(site), site.target.config
    if device.heartbeat is None:
        sentence = (
            "no heartbeat is named: a program that stands still cannot be told from one at rest (decanter "
            "plc bind --heartbeat TAG)"
        )
        return [warning("heartbeat", sentence)]
    first = next(sample.value for sample in before if sample.tag == device.heartbeat)
    if first == 0:
        return [failed_step("heartbeat", f"{device.heartbeat} is 0: the PLC's program does not run")]
    patience = max(config.device.heartbeat_period if config else 0.0, find_period(site))
    begun = time.monotonic()
    tag = device.by_name[device.heartbeat]
    # Asked five times within its patience: a program that counts fast may stand at the same number at one moment.
    while (left := patience - (time.monotonic() - begun)) > 0:
        await asyncio.sleep(min(left, patience / 5))
        now = (await read_raw(site, [tag]))[0].sample
        if now.value not in (first, None):
            took = time.monotonic() - begun
            return [ok("heartbeat", f"{device.heartbeat} went from {first} to {now.value} within {took:.2g} s")]
    return [failed_step("heartbeat", f"{device.heartbeat} stood at {first} for {patience:g} s: does the program run?")]


# ---------------------------------------------------------------- several machines


_OF_ONE_MACHINE = frozenset({"host", "port", "unit", "serial", "channel", "node"})
"""Settings that no two machines have in common."""


def _several(given: SharedOptions) -> list[str]:
    """The machines of the plant file where it has several and none is named; else nothing."""
    if given.plant is None or given.device is not None or given.machine is not None or given.link is not None:
        return []
    with sentences():
        names = [config.machine for config in load_plant(given.plant)]
    return names if len(names) > 1 else []


def _link_sites(given: SharedOptions, site: Site) -> dict[str, Site]:
    """The device over each of its links, where none is named."""
    if site.target.config is None or given.link is not None:
        return {site.target.kind: site}
    links = site.target.config.links
    others = {
        link.name: replace(site, target=make_target(given.plant, link=link.name, machine=given.machine))
        for link in links[1:]
    }
    return {links[0].name: site, **others}


def _join_machines(results: Mapping[str, CommandResult]) -> CommandResult:
    """The results of all machines; the first one that is not in order gives exit code and sentence."""
    failing = {name: result for name, result in results.items() if result.complaint}
    data = {
        "machines": {name: {**result.data, "exit": int(result.code)} for name, result in results.items()},
        "open_points": [f"{name}: {point}" for name, result in results.items() for point in result.data["open_points"]],
    }
    if not failing:
        return CommandResult(data)
    name, first = next(iter(failing.items()))
    others = f" ({len(failing)} of {len(results)} machines are not in order: {', '.join(failing)})"
    return CommandResult(data, f"{name}: {first.complaint}{others if len(failing) > 1 else ''}", first.failing)


def _machine_lines(data: Mapping[str, Any]) -> Iterator[Part]:
    for name, own in data["machines"].items():
        yield Line(f"{name}  {'; '.join(own['links'].values())}", bold=True)
        yield from step_lines(own)


def check(given: SharedOptions, offline: bool) -> None:
    """Carry out `decanter plc check`; its options and its help are in commission/commands.py."""
    names = _several(given)
    if not names:
        perform(
            given,
            "check",
            {"offline": offline},
            lambda site: check_configuration(_link_sites(given, site), offline=offline),
            step_lines,
        )
        return
    if alone := _OF_ONE_MACHINE & set(given.settings):
        raise click.UsageError(
            f"--{min(alone)} is one machine's, and the plant file has several; name it with --machine"
        )

    async def work(site: Site) -> CommandResult:
        results = {}
        for name in names:
            # One after another: units behind one gateway may not be asked side by side.
            of_one = replace(given, machine=name)
            target = make_target(given.plant, given=given.settings, machine=name)
            results[name] = await check_configuration(
                _link_sites(of_one, replace(site, target=target)), offline=offline
            )
        return _join_machines(results)

    with sentences():
        first = make_target(given.plant, machine=names[0])
    perform(given, "check", {"offline": offline}, work, _machine_lines, target=replace(first, kind="", settings={}))
