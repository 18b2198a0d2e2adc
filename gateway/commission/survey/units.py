"""`scan units` and `scan nodes`: who answers behind one connection, or on one bus."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from drivers.driver import LINKS
from drivers.errors import DeviceException, ReplyMismatch, ReplyTimeout
from drivers.survey import AsksRegisters, open_bus_survey, open_registers
from gateway.commission.session import CommandResult, Site, mention_gateway
from gateway.commission.survey.addresses import Register
from gateway.commission.survey.bus_probe import HEARTBEAT, STATES, identity_of
from gateway.commission.survey.registers import first_register
from gateway.entry import Exit

Progress = Callable[[str, float], None]
UNIT_S = 0.25
LISTEN_S = 1.5
NODE_S = 0.06
_BEHIND_GATEWAY = frozenset({10, 11})


async def scan_units(site: Site, units: Sequence[int], progress: Progress) -> CommandResult:
    """Every unit asked once, and once more if silent; a refusal is an answer too, except a gateway's own."""
    mention_gateway(site)
    configured = site.target.settings
    # Silence is the usual answer here, and 247 usual timeouts would take minutes.
    hurried = {"timeout": configured.get("timeout", UNIT_S)}
    if site.target.kind in LINKS and LINKS[site.target.kind].line:
        hurried["longest_reply"] = configured.get("longest_reply", hurried["timeout"])
    register = first_register(site.target)
    rows: list[dict[str, Any]] = []
    settings = site.target.with_settings(**hurried).settings
    async with open_registers(site.target.driver, settings, clock=time.time) as survey:
        try:
            for place, unit in enumerate(units):
                progress(f"unit {unit}", place / len(units))
                if (row := await _unit(survey, unit, register)) is not None:
                    rows.append(row)
        finally:
            site.count(survey.statistics())
    if not rows:
        sentence = (
            f"none of {len(units)} units answers: wrong port, or frames of another kind (see `decanter plc probe`)"
        )
        return CommandResult({"units": rows, "asked": len(units)}, Exit.TIMEOUT, sentence)
    return CommandResult({"units": rows, "asked": len(units)})


async def _unit(survey: AsksRegisters, unit: int, register: Register) -> dict[str, Any] | None:
    """What one unit answers; None if nothing. Raises LinkDown when the connection does not come back."""
    begun = time.monotonic()
    for last in (False, True):
        try:
            words = await survey.read(register.table, register.number, 1, unit)
        except DeviceException as error:
            if error.code in _BEHIND_GATEWAY:
                return None
            answer = str(error)
        except (ReplyTimeout, ReplyMismatch):
            if last:
                return None
            begun = time.monotonic()
            continue
        else:
            answer = f"{register} is {words.words[0]}"
        row: dict[str, Any] = {"unit": unit, "answer": answer, "ms": 1e3 * (time.monotonic() - begun), "identity": ""}
        # Most devices do not know the function that asks who they are.
        with suppress(DeviceException, ReplyTimeout, ReplyMismatch):
            row["identity"] = " ".join((await survey.identity(unit)).values())
        return row
    return None


async def scan_nodes(site: Site, nodes: Sequence[int], progress: Progress, *, listen_only: bool) -> CommandResult:
    """The CANopen nodes of a bus: by their heartbeats, and unless `listen_only` by their answers to SDO requests."""
    async with open_bus_survey(site.target.driver, site.target.settings, clock=time.time) as survey:
        try:
            progress("listening", 0.0)
            frames = await survey.listen(LISTEN_S)
            beats = {
                frame.id - HEARTBEAT: frame.data[0] & 0x7F
                for frame in frames
                if not frame.extended and HEARTBEAT < frame.id <= HEARTBEAT + 127 and len(frame.data) == 1
            }
            rows: list[dict[str, Any]] = []
            for place, node in enumerate(nodes):
                progress(f"node {node}", place / len(nodes))
                # Every CANopen node has its device type (CiA 301, 7.5.2.1): an answer counts, whatever it says.
                answers = not listen_only
                try:
                    if answers:
                        await survey.object(node, 0x1000, 0, NODE_S)
                except ReplyTimeout:
                    answers = False
                except (DeviceException, ReplyMismatch):
                    pass
                identity = await identity_of(survey, node) if answers else None
                if identity is not None or node in beats:
                    state = beats.get(node)
                    sentence = "no heartbeat" if state is None else STATES.get(state, f"state {state}")
                    rows.append({"node": node, "heartbeat": sentence, "sdo": identity is not None, **(identity or {})})
        finally:
            site.count(survey.statistics())
    if not rows:
        sentence = f"none of {len(nodes)} nodes: {len(frames)} frames were heard; check the bit rate and the wiring"
        return CommandResult({"nodes": rows, "asked": len(nodes)}, Exit.TIMEOUT, sentence)
    return CommandResult({"nodes": rows, "asked": len(nodes)})
