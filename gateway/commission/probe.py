"""`decanter plc probe`: is the device there, does it speak, and who is it? The first step that fails ends it."""

import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack, suppress
from statistics import median
from typing import Any

import click

from drivers.driver import LINKS
from drivers.errors import DeviceException, DriverError, LinkDown, LinkFault, ReplyMismatch, ReplyTimeout
from drivers.survey import AsksRegisters, open_registers
from gateway.commission.session import (
    CONNECT_S,
    CheckStep,
    CommandResult,
    SharedOptions,
    Site,
    Target,
    failed,
    link_options,
    mention_gateway,
    ok,
    perform,
    show_steps,
    verdict,
    warning,
)
from gateway.commission.survey import (
    Register,
    addresses_of,
    connect_sentence,
    first_register,
    greeting_of,
    local_end,
    looks_like,
    not_modbus,
    probe_bus,
)

ROUND_TRIPS = 10
OTHER_UNITS = (1, 255, 0, 2, 247)
"""Asked when the given unit is silent: what devices and gateways use where nothing was set."""
_BEHIND_GATEWAY = (10, 11)
_ILLEGAL_FUNCTION = 1
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
        await _probe_driver(site, steps)
    code, complaint = verdict(steps)
    return CommandResult({"steps": [step.plain() for step in steps], **facts}, code, complaint)


async def _probe_modbus(site: Site, steps: list[CheckStep], facts: dict[str, Any]) -> None:
    settings = site.target.settings
    if "host" in settings and not await _way(str(settings["host"]), steps, facts):
        return
    target = site.target
    if "connect_timeout" not in settings:
        target = target.with_settings(connect_timeout=CONNECT_S)
    async with AsyncExitStack() as stack:
        try:
            opening = open_registers(target.driver, target.settings, clock=time.time)
            survey = await stack.enter_async_context(opening)
        except LinkDown as error:
            steps.append(failed("connection", _no_connection(target, error), error))
            return
        steps.append(ok("connection", f"{target.place} is open"))
        try:
            first = await _speaks(site, survey, steps)
            if first is not None:
                await _facts(survey, first, steps, facts)
        finally:
            site.count(survey.statistics())


async def _probe_driver(site: Site, steps: list[CheckStep]) -> None:
    """A device that cannot be asked by hand: whether its driver finds it."""
    try:
        async with site.target.opened() as driver:
            steps.append(ok("connection", f"the driver {site.target.driver!r} has its device"))
            site.count(driver.statistics())
    except DriverError as error:
        steps.append(failed("connection", str(error), error))


async def _way(host: str, steps: list[CheckStep], facts: dict[str, Any]) -> bool:
    """Name and route; False ends the probe."""
    try:
        facts["addresses"] = await addresses_of(host)
    except (OSError, UnicodeError):
        sentence = f"{host!r} is no address, and no name that this machine can resolve: check it, or give the address"
        steps.append(failed("name", sentence, LinkDown(sentence)))
        return False
    steps.append(ok("name", f"{host} is {', '.join(facts['addresses'])}"))
    try:
        facts["local"] = local_end(facts["addresses"][0])
    except OSError as error:
        sentence = f"this machine has no way to {facts['addresses'][0]} ({error.strerror}): check its network settings"
        steps.append(failed("route", sentence, LinkDown(sentence)))
        return False
    steps.append(ok("route", f"from {facts['local']} to {facts['addresses'][0]}"))
    return True


def _no_connection(target: Target, error: LinkDown) -> str:
    settings = target.settings
    if "host" in settings:
        return connect_sentence(str(settings["host"]), port_of(settings), error)
    return f"{error}: is the adapter plugged in, is another program using it, and may this user open it (dialout)?"


def port_of(settings: Mapping[str, Any]) -> int:
    """The TCP port, the standard's where none is given."""
    return int(settings.get("port", 802 if settings.get("transport") == "tls" else 502))


# ---------------------------------------------------------------- does it speak Modbus


async def _speaks(site: Site, survey: AsksRegisters, steps: list[CheckStep]) -> Register | None:
    """Whether the unit answers; the register that was asked."""
    register = first_register(site.target)
    unit = int(site.target.settings.get("unit", 1))
    begun = time.monotonic()
    try:
        words = await survey.read(register.table, register.number, 1)
    except DeviceException as error:
        if error.code in _BEHIND_GATEWAY:
            text = f"a gateway answers for unit {unit} that it cannot reach it (exception {error.code})"
            text += _hint(await _other_units(survey, unit))
            steps.append(failed("modbus", text, error))
            return None
        took = 1e3 * (time.monotonic() - begun)
        steps.append(ok("modbus", f"unit {unit} answers in {took:.1f} ms, with a refusal: {error}"))
    except ReplyTimeout as error:
        sentence, kind = await _silent(site, survey, unit, error)
        steps.append(failed("modbus", sentence, kind))
        return None
    except ReplyMismatch as error:
        steps.append(failed("modbus", f"{error}: what answers does not keep to the protocol", LinkDown(str(error))))
        return None
    except LinkDown as error:
        steps.append(failed("modbus", _strange(site, error), error))
        return None
    else:
        steps.append(ok("modbus", f"unit {unit} answers in {1e3 * words.seconds:.1f} ms"))
    return register


def _strange(site: Site, error: LinkDown) -> str:
    """The peer was there and broke off: another protocol, or busy."""
    received = site.evidence.greeting
    if received and (error.fault is LinkFault.FOREIGN or looks_like(received)):
        return not_modbus(port_of(site.target.settings), received)
    return str(error)


async def _silent(
    site: Site, survey: AsksRegisters, unit: int, error: ReplyTimeout
) -> tuple[str, ReplyTimeout | LinkDown]:
    """Connected and no reply: another unit, another protocol, or nothing at all. The sentence, and its kind."""
    settings = site.target.settings
    others = await _other_units(survey, unit)
    text = f"unit {unit} does not answer{_hint(others)}"
    other = LINKS[site.target.kind].mistaken_for if site.target.kind in LINKS else ""
    if others or not other:
        return text, error
    received = site.evidence.greeting or await greeting_of(str(settings["host"]), port_of(settings))
    if looks_like(received):
        sentence = not_modbus(port_of(settings), received)
        return sentence, LinkDown(sentence)
    sentence = (
        f"{text}: the port takes connections and answers no request; is it a Modbus port, is the device busy with "
        f"another client, or does it want other frames (--link {other})? `decanter plc scan units` tries all units"
    )
    return sentence, error


async def _other_units(survey: AsksRegisters, unit: int) -> list[int]:
    """The units that do answer, of those that devices have where nothing was set."""
    found = []
    for other in OTHER_UNITS:
        if other == unit:
            continue
        try:
            await survey.read("holding", 0, 1, other)
        except DeviceException as error:
            found += [] if error.code in _BEHIND_GATEWAY else [other]
        except (ReplyTimeout, ReplyMismatch):
            continue
        except DriverError:  # a serial line knows no unit 0 or 255, or the connection is gone
            break
        else:
            found.append(other)
    return found


def _hint(others: Sequence[int]) -> str:
    """What goes on the sentence of a silent unit; "" where no other one answers."""
    return f", and unit {' and '.join(map(str, others))} does: give --unit {others[0]}" if others else ""


# ---------------------------------------------------------------- who is it


async def _facts(survey: AsksRegisters, register: Register, steps: list[CheckStep], facts: dict[str, Any]) -> None:
    try:
        facts["identity"] = dict(await survey.identity())
        steps.append(ok("identity", ", ".join(f"{name} {text}" for name, text in facts["identity"].items()) or "empty"))
    except (DeviceException, ReplyTimeout, ReplyMismatch):
        steps.append(warning("identity", "the device does not say who it is (function 43), as most do not"))
    facts["tables"] = await _tables(survey)
    steps.append(ok("tables", ", ".join(f"{table} {state}" for table, state in facts["tables"].items())))
    times = []
    for _ in range(ROUND_TRIPS):
        begun = time.monotonic()
        with suppress(DeviceException):
            await survey.read(register.table, register.number, 1)
        times.append(1e3 * (time.monotonic() - begun))
    facts["round_trip_ms"] = {"min": min(times), "median": median(times), "max": max(times)}
    sentence = ", ".join(f"{name} {value:.2f}" for name, value in facts["round_trip_ms"].items())
    steps.append(ok("round trip", f"{ROUND_TRIPS} requests, ms: {sentence}"))


async def _tables(survey: AsksRegisters) -> dict[str, str]:
    """What each table answers to a read of its first address."""
    found = {}
    for table in _TABLES:
        try:
            await survey.read(table, 0, 1)
        except DeviceException as error:
            found[table] = "not offered" if error.code == _ILLEGAL_FUNCTION else "offered (address 0 refused)"
        except (ReplyTimeout, ReplyMismatch):
            found[table] = "no reply"
        else:
            found[table] = "offered"
    return found


@click.command()
@link_options
def probe(given: SharedOptions) -> None:
    """Is the device there, does it speak, and who is it?

    Name, route, connection, first reply, identity, tables and round trip; for CAN the bus, its traffic and the node.
    Each step that fails has its own sentence. Nothing but reads is sent.
    """
    perform(given, "probe", {}, probe_device, show_steps)
