"""`decanter plc probe`: is the device there, does it speak, and who is it? The first step that fails ends it."""

import json
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from dataclasses import replace
from math import ceil
from statistics import median
from typing import Any

import click

from drivers.driver import LINKS
from drivers.errors import (
    NO_WAY_TO_UNIT,
    DeviceException,
    DriverError,
    LinkDown,
    LinkFault,
    ReplyMismatch,
    ReplyTimeout,
)
from drivers.survey import AsksRegisters
from gateway.commission.options import SharedOptions
from gateway.commission.session import (
    CONNECT_S,
    CheckStep,
    Site,
    conclude_steps,
    failed_step,
    mention_gateway,
    ok,
    perform,
    step_lines,
    warning,
)
from gateway.commission.survey import (
    ILLEGAL_FUNCTION,
    Register,
    connect_sentence,
    first_register,
    guess_service,
    local_end,
    not_modbus,
    probe_bus,
    read_greeting,
    resolve_host,
)
from gateway.console import CommandResult, Part

ROUND_TRIPS = 10
TIMEOUTS_S = (0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, 20.0, 30.0, 60.0)
"""Timeouts that are proposed."""
UNREQUESTED_WAIT_S = 0.25
"""A first answer that takes longer than this and than all others comes of a device that is silent at first."""
OTHER_UNITS = (1, 255, 0, 2, 247)
"""Asked when the given unit is silent: what devices and gateways use where nothing was set."""
MOST_REMEDIES = 3
"""Settings that are tried on a device that answers in an unusual way."""
_HABITS = {
    "transaction_id": "its answers have another transaction id than the request",
    "answers_as": "its answers are from another unit than the one that is asked",
    "echo": "the adapter gives back what is sent, or no longer does",
}
_OF_THE_FIRMWARE = "revision"
"""What a device says of itself and is no part of who it is: an update changes it."""
_TABLES = ("coil", "discrete", "input", "holding")


async def probe_device(site: Site) -> CommandResult:
    """Every step to the device, who it is, and which tables it offers. Sends reads only."""
    steps: list[CheckStep] = []
    facts: dict[str, Any] = {}
    mention_gateway(site)
    own = site.target.capabilities
    if own.registers:
        await _probe_modbus(site, steps, facts)
    elif own.bus:
        await probe_bus(site, steps, facts)
    else:
        # A device that cannot be asked by hand: whether its driver finds it is all that can be known.
        try:
            async with site.driver():
                steps.append(ok("connection", f"the driver {site.target.driver!r} has its device"))
        except DriverError as error:
            steps.append(failed_step("connection", str(error), error))
    return conclude_steps(steps, **facts)


async def _probe_modbus(site: Site, steps: list[CheckStep], facts: dict[str, Any]) -> None:
    """Name, route, connection, first reply, then who it is; returns at the first that fails."""
    settings = site.target.settings
    if "host" in settings:
        # Name and route come before the connection: a connection refused by this machine's own network settings looks
        # like a device that is off.
        host = str(settings["host"])
        try:
            facts["addresses"] = await resolve_host(host)
        except (OSError, UnicodeError):
            sentence = (
                f"{host!r} is no address, and no name that this machine can resolve: check it, or give the address"
            )
            steps.append(failed_step("name", sentence, LinkDown(sentence)))
            return
        steps.append(ok("name", f"{host} is {', '.join(facts['addresses'])}"))
        try:
            facts["local"] = local_end(facts["addresses"][0])
        except OSError as error:
            sentence = (
                f"this machine has no way to {facts['addresses'][0]} ({error.strerror}): check its network settings"
            )
            steps.append(failed_step("route", sentence, LinkDown(sentence)))
            return
        steps.append(ok("route", f"from {facts['local']} to {facts['addresses'][0]}"))
    habits: dict[str, Any] = {}
    failures: list[CheckStep] = []
    while True:
        tried: list[CheckStep] = []
        remedy = await _ask_device(site, habits, tried, facts)
        failures = failures or tried
        if not remedy or remedy.items() <= habits.items() or len(habits) >= MOST_REMEDIES:
            break
        # What comes in an unusual way may be read by another setting: it is tried, and kept if it brings an answer.
        habits |= remedy
    # Of several tries that bring no answer the first one says what is wrong.
    steps += tried if remedy is None else failures
    if remedy is None:
        await _confirm_habits(site, habits, steps, facts)


async def _confirm_habits(site: Site, habits: Mapping[str, Any], steps: list[CheckStep], facts: dict[str, Any]) -> None:
    """Which of the habits a connection more shows as well: what is shown once is an accident, and no setting."""
    found: dict[str, Any] = {}
    for key, value in habits.items():
        try:
            without = await _first_answer(site, {other: habits[other] for other in habits if other != key})
        except DriverError as error:
            sentence = f"{_HABITS[key]}: not confirmed, as another connection failed ({error}); nothing is set"
            steps.append(warning("habit", sentence))
            continue
        if without is None:
            found[key] = value
            steps.append(warning("habit", f"{_HABITS[key]}: {_toml(key, value)} in [device] of the device file"))
        else:
            steps.append(ok("habit", f"{_HABITS[key]}: once, and not over another connection; nothing is set"))
    # An answer that took long, and no other one did: the device was silent at first, and is not slow.
    first, slowest = facts.pop("seconds_to_first", 0.0), facts.get("round_trip_ms", {}).get("max", 0.0) / 1e3
    if first > max(UNREQUESTED_WAIT_S, 4 * slowest):
        try:
            again, other = await _first_answer(site, found), "brought none"
        except DriverError as error:
            again, other = None, f"failed ({error})"
        if again is not None and again > max(UNREQUESTED_WAIT_S, 4 * slowest):
            pause = found["pause_after_connect"] = 0.1 * ceil(10 * max(first, again))
            sentence = f"answers nothing for up to {pause:.1f} s after connecting: pause_after_connect = {pause:.1f}"
            steps.append(warning("habit", sentence))
        else:
            other = other if again is None else f"took {again:.1f} s for it"
            steps.append(
                ok("habit", f"the first answer took {first:.1f} s, and another connection {other}: nothing is set")
            )
    if found:
        facts["habits"] = found


async def _first_answer(site: Site, habits: Mapping[str, Any]) -> float | None:
    """Seconds to the first answer over a connection of its own; None where none comes that fits what is asked.

    Raises DriverError where the connection itself fails, which says nothing of a habit.
    """
    patience = site.target.settings.get("connect_timeout", CONNECT_S)
    register = first_register(site.target)
    try:
        async with site.registers(connect_timeout=patience, **habits) as survey:
            with suppress(DeviceException):  # a refusal is an answer
                await survey.read(register.table, register.number, 1)
            return survey.statistics().get("seconds_to_first", 0.0)
    except (ReplyTimeout, ReplyMismatch):
        return None  # also of a question that was not asked again, as this connection owed the answer to the one before


async def _ask_device(
    site: Site, habits: Mapping[str, Any], steps: list[CheckStep], facts: dict[str, Any]
) -> Mapping[str, Any] | None:
    """Connection, first reply, who it is: None; else the settings by which what came may be read, empty for none."""
    settings = site.target.settings
    patience = settings.get("connect_timeout", CONNECT_S)
    async with AsyncExitStack() as stack:
        try:
            survey = await stack.enter_async_context(site.registers(connect_timeout=patience, **habits))
        except LinkDown as error:
            sentence = (
                f"{error}: is the adapter plugged in, is another program using it, and may this user open it (dialout)?"
            )
            if "host" in settings:
                sentence = connect_sentence(str(settings["host"]), tcp_port(settings), error)
            steps.append(failed_step("connection", sentence, error))
            return {}
        steps.append(ok("connection", f"{site.target.place} is open"))
        found = await _speaks(site, survey, steps)
        if isinstance(found, Register):
            await _facts(site, survey, found, steps, facts)
            return None
        return found


def _toml(key: str, value: object) -> str:
    """A setting as it stands in a file."""
    return f"{key} = {str(value).lower() if isinstance(value, bool) else json.dumps(value)}"


def tcp_port(settings: Mapping[str, Any]) -> int:
    """The TCP port, the standard's where none is given."""
    return int(settings.get("port", 802 if settings.get("transport") == "tls" else 502))


# ---------------------------------------------------------------- does it speak Modbus


async def _speaks(site: Site, survey: AsksRegisters, steps: list[CheckStep]) -> Register | Mapping[str, Any]:
    """Whether the unit answers; the register that was asked, or where the probe ends here settings that may help."""
    settings = site.target.settings
    register = first_register(site.target)
    unit = int(settings.get("unit", 1))
    try:
        refusal, seconds = await _first_read(survey, register)
    except ReplyTimeout as error:
        # Connected and no reply: another unit, another protocol, or nothing at all. The other units are asked first,
        # because one that answers settles that it is Modbus.
        others = await _other_units(survey, unit)
        sentence = f"unit {unit} does not answer{_hint(others)}"
        if not others and survey.statistics()["foreign_replies"]:
            sentence = (
                f"something answers, and no answer to unit {unit} has its request's transaction id ({error}): give "
                'transaction_id = "any", or a longer timeout if they only come late'
            )
            steps.append(failed_step("modbus", sentence, error))
            return error.remedy
        cause: ReplyTimeout | LinkDown = error
        other = LINKS[site.target.kind].mistaken_for if site.target.kind in LINKS else ""
        if not others and other:
            # A server that greets (SSH, SMTP, FTP) may have done so before the first request or only now.
            received = site.evidence.greeting or await read_greeting(str(settings["host"]), tcp_port(settings))
            if guess_service(received):
                sentence = not_modbus(tcp_port(settings), received)
                cause = LinkDown(sentence)
            else:
                sentence += (
                    ": the port takes connections and answers no request; is it a Modbus port, is the device busy with "
                    f"another client, or does it want other frames (--link {other})? `decanter plc scan units` tries "
                    "all units"
                )
        steps.append(failed_step("modbus", sentence, cause))
        return error.remedy
    except ReplyMismatch as error:
        keeps = "" if "answers_as" in str(error) else ": what answers does not keep to the protocol"
        steps.append(failed_step("modbus", f"{error}{keeps}", LinkDown(str(error))))
        return error.remedy
    except LinkDown as error:
        # The peer was there and broke off: it speaks another protocol, or it is busy.
        received = site.evidence.greeting
        foreign = received and (error.fault is LinkFault.FOREIGN or guess_service(received))
        sentence = not_modbus(tcp_port(settings), received) if foreign else str(error)
        steps.append(failed_step("modbus", sentence, error))
        return {}
    if refusal is not None and refusal.code in NO_WAY_TO_UNIT:
        text = f"a gateway answers for unit {unit} that it cannot reach it (exception {refusal.code})"
        text += _hint(await _other_units(survey, unit))
        steps.append(failed_step("modbus", text, refusal))
        return {}
    # Any other exception is the unit's own: it speaks Modbus, and merely has no such register.
    words = "" if refusal is None else f", with a refusal: {refusal}"
    steps.append(ok("modbus", f"unit {unit} answers in {1e3 * seconds:.1f} ms{words}"))
    return register


async def _first_read(survey: AsksRegisters, register: Register) -> tuple[DeviceException | None, float]:
    """How a register is refused, or None, and the seconds that this question took by itself."""
    try:
        return None, (await survey.read(register.table, register.number, 1)).seconds
    except DeviceException as error:
        # The pauses before a gateway's word is believed are none of the device's: the survey leaves them out.
        return error, survey.statistics().get("seconds_to_first", 0.0)


async def _other_units(survey: AsksRegisters, unit: int) -> list[int]:
    """The units that do answer, of those that devices have where nothing was set."""
    answering = []
    for other in OTHER_UNITS:
        if other == unit:
            continue
        try:
            await survey.read("holding", 0, 1, other)
        except DeviceException as error:
            answering += [] if error.code in NO_WAY_TO_UNIT else [other]
        except (ReplyTimeout, ReplyMismatch):
            continue
        except DriverError:  # a serial line knows no unit 0 or 255, or the connection is gone
            break
        else:
            answering.append(other)
    return answering


def _hint(others: Sequence[int]) -> str:
    """What goes on the sentence of a silent unit; "" where no other one answers."""
    return f", and unit {' and '.join(map(str, others))} does: give --unit {others[0]}" if others else ""


# ---------------------------------------------------------------- who is it


async def _identity(site: Site, survey: AsksRegisters, steps: list[CheckStep], facts: dict[str, Any]) -> None:
    """Who the device says it is (functions 43 and 17), held against what is pinned."""
    said: dict[str, str] = {}
    slip: ReplyMismatch | None = None
    try:
        facts["identity"] = dict(await survey.identity())
        said |= {name: text for name, text in facts["identity"].items() if text}
    except ReplyMismatch as error:
        slip = error
    except (DeviceException, ReplyTimeout, LinkDown):
        pass
    with suppress(DeviceException, ReplyTimeout, ReplyMismatch, LinkDown):
        if text := await survey.server_id():
            facts["server_id"] = said["server id"] = text
    if said:
        steps.append(ok("identity", ", ".join(f"{name} {text}" for name, text in said.items())))
    elif slip is not None:
        steps.append(warning("identity", f"what the device says of itself is not taken: {slip}"))
    else:
        steps.append(warning("identity", "the device does not say who it is (functions 43 and 17), as most do not"))
    if site.target.settings.get("identity"):
        try:
            reason = await survey.stranger()
        except DriverError as error:
            steps.append(failed_step("pinned", f"whether this is the pinned device is not known: {error}", error))
            return
        steps.append(
            failed_step("pinned", reason, LinkDown(reason)) if reason else ok("pinned", "it is the pinned device")
        )
    elif lasting := {name: text for name, text in said.items() if name != _OF_THE_FIRMWARE}:
        facts["proposed_identity"] = lasting
        marks = ", ".join(f"{json.dumps(name)} = {json.dumps(text)}" for name, text in lasting.items())
        sentence = (
            f"identity = {{ {marks} }} in [device] tells it from another kind; from its twin a serial number in "
            'registers does, as "holding:300-307" = "..."'
        )
        steps.append(ok("proposal", sentence))


async def _facts(
    site: Site, survey: AsksRegisters, register: Register, steps: list[CheckStep], facts: dict[str, Any]
) -> None:
    await _identity(site, survey, steps, facts)
    facts["tables"] = tables = {}
    for table in _TABLES:
        try:
            await survey.read(table, 0, 1)
        except DeviceException as error:
            # A device that lacks the table refuses the function; any other refusal is of the address alone.
            tables[table] = "not offered" if error.code == ILLEGAL_FUNCTION else "offered (address 0 refused)"
        except (ReplyTimeout, ReplyMismatch, LinkDown):
            tables[table] = "no reply"
        else:
            tables[table] = "offered"
    steps.append(ok("tables", ", ".join(f"{table} {state}" for table, state in tables.items())))
    times: list[float] = []
    lost: list[DriverError] = []
    while len(times) < ROUND_TRIPS and len(lost) < ROUND_TRIPS:
        begun = time.monotonic()
        try:
            with suppress(DeviceException):  # a refusal makes the round trip as well as an answer
                await survey.read(register.table, register.number, 1)
            times.append(1e3 * (time.monotonic() - begun))
        except (ReplyTimeout, ReplyMismatch, LinkDown) as error:
            lost.append(error)  # the device has answered before: others are asked for all that
    if lost:
        sentence = f"{len(lost)} of {len(lost) + len(times)} requests brought no answer: {lost[-1]}"
        steps.append(warning("answers", sentence) if times else failed_step("answers", sentence, lost[-1]))
    if not times:
        return
    facts["round_trip_ms"] = {"min": min(times), "median": median(times), "max": max(times)}
    sentence = ", ".join(f"{name} {value:.2f}" for name, value in facts["round_trip_ms"].items())
    steps.append(ok("round trip", f"{len(times)} requests, ms: {sentence}"))
    facts["seconds_to_first"] = survey.statistics().get("seconds_to_first", 0.0)
    timeout, attempts = propose_timeout(facts["round_trip_ms"]["max"] / 1e3)
    facts["proposed"] = {"timeout": timeout, "attempts": attempts}
    steps.append(ok("proposal", f"timeout = {timeout:g} and attempts = {attempts} in [device] of the plant file"))


def propose_timeout(slowest: float) -> tuple[float, int]:
    """`timeout` (s) and `attempts` for a device whose slowest of ROUND_TRIPS answers took `slowest` seconds.

    Half as long again as that, but room for a busy moment: a device is not given up for one slow answer. A slow one is
    asked once only, as asking again would double what it has to do.
    """
    timeout = next((step for step in TIMEOUTS_S if step >= max(1.5 * slowest, slowest + 0.1)), TIMEOUTS_S[-1])
    return timeout, 2 if timeout <= 1.0 else 1


def probe(given: SharedOptions, write: bool, pin: bool) -> None:
    """Carry out `decanter plc probe`; its options and its help are in commission/commands.py."""
    if pin and not write:
        raise click.UsageError("--pin says what --write puts into the device file: give both")
    if write and given.plant is None and given.device is None:
        raise click.UsageError("--write puts what is found into a device file: give --device FILE or --config FILE")

    async def work(site: Site) -> CommandResult:
        result = await probe_device(site)
        return _keep_findings(given, result, pin=pin) if write and not result.complaint else result

    perform(given, "probe", {"write": write, "pin": pin}, work, _view)


def _keep_findings(given: SharedOptions, result: CommandResult, *, pin: bool) -> CommandResult:
    """What was found, in the device file. Raises ConfigError or OSError."""
    # What changes files loads more than a probe needs.
    from gateway.commission.files import FileChange, apply_change, find_files, template

    found = dict(result.data.get("habits", {}))
    if pin:
        found |= {"identity": identity} if (identity := result.data.get("proposed_identity")) else {}
    files = find_files(given.plant, given.device, given.link, given.settings, given.machine)
    done = apply_change(files, FileChange(device=found), template(), dry_run=False) if found else {"written": False}
    return replace(result, data={**result.data, **done})


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    yield from step_lines(data)
    if "written" in data:
        kept = f" (before: {', '.join(data['backups'])})" if data.get("backups") else ""
        yield f"written: {', '.join(data['files'])}{kept}" if data["written"] else "nothing to write: the file says so"
