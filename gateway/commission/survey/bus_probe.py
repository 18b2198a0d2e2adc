"""The steps of a probe on a CAN bus: does it open, does anybody speak, and does the CANopen node say who it is."""

import time
from typing import Any

from drivers.errors import DeviceException, LinkDown, ReplyMismatch, ReplyTimeout
from drivers.survey import BusFrame, ListensToBus, open_bus_survey
from gateway.commission.session import CheckStep, Site, failed, ok, warning

LISTEN_S = 1.5
SDO_S = 0.3
HEARTBEAT = 0x700
STATES = {0: "booting", 4: "stopped", 5: "operational", 127: "pre-operational"}
_TEXTS = {"name": (0x1008, 0), "hardware": (0x1009, 0), "software": (0x100A, 0)}
_NUMBERS = {"device type": (0x1000, 0), "vendor": (0x1018, 1), "product": (0x1018, 2), "revision": (0x1018, 3)}


async def probe_bus(site: Site, steps: list[CheckStep], facts: dict[str, Any]) -> None:
    """Open, listen, and with CANopen ask the node who it is. Without CANopen nothing is sent."""
    settings = site.target.settings
    try:
        async with open_bus_survey(site.target.driver, settings, clock=time.time) as survey:
            steps.append(ok("bus", f"{settings.get('interface', 'socketcan')} {settings['channel']} is open"))
            try:
                frames = await survey.listen(LISTEN_S)
                ids = {(frame.id, frame.extended) for frame in frames}
                facts["heard"], facts["ids"] = len(frames), len(ids)
                silence = (
                    f"no frame in {LISTEN_S:g} s: another bit rate, no device on the bus, or one that speaks only when "
                    "asked"
                )
                if frames:
                    steps.append(ok("traffic", f"{len(frames)} frames of {len(ids)} ids in {LISTEN_S:g} s"))
                elif site.target.capabilities.nodes:  # the node is asked next, and may answer
                    steps.append(warning("traffic", silence))
                else:
                    steps.append(failed("traffic", silence, ReplyTimeout(silence)))
                if site.target.capabilities.nodes:
                    await _node(survey, int(settings.get("node", 1)), frames, steps, facts)
            finally:
                site.count(survey.statistics())
    except LinkDown as error:
        hint = "is the interface there and up (ip link set can0 up type can bitrate ...)?"
        hint = hint if settings.get("interface", "socketcan") == "socketcan" else "is the hub or adapter there?"
        steps.append(failed("bus", f"{error}: {hint}", error))


async def _node(
    survey: ListensToBus, node: int, frames: list[BusFrame], steps: list[CheckStep], facts: dict[str, Any]
) -> None:
    beats = [frame for frame in frames if not frame.extended and frame.id == HEARTBEAT + node and frame.data]
    if beats:
        state = beats[-1].data[0] & 0x7F  # bit 7 is the toggle bit of node guarding (CiA 301)
        steps.append(ok("heartbeat", f"node {node} is {STATES.get(state, f'in state {state}')}"))
    else:
        steps.append(warning("heartbeat", f"node {node} sent no heartbeat in {LISTEN_S:g} s (object 0x1017 may be 0)"))
    try:
        facts["identity"] = await identity_of(survey, node)
    except ReplyTimeout as error:
        others = sorted({frame.id - HEARTBEAT for frame in frames if HEARTBEAT < frame.id <= HEARTBEAT + 127})
        seen = f"; heartbeats come from node {', '.join(map(str, others))}: give --node" if others else ""
        steps.append(failed("node", f"node {node} answers no SDO request: wrong node, or it is off{seen}", error))
    except ReplyMismatch as error:
        steps.append(failed("node", str(error), error))
    else:
        steps.append(ok("node", ", ".join(f"{name} {value}" for name, value in facts["identity"].items())))


async def identity_of(survey: ListensToBus, node: int, timeout: float = SDO_S) -> dict[str, str]:
    """What a node says of itself; the objects that it does not have are left out.

    Raises ReplyTimeout where it does not answer at all.
    """
    identity = {}
    for name, (index, subindex) in {**_NUMBERS, **_TEXTS}.items():
        try:
            data = await survey.object(node, index, subindex, timeout)
        except DeviceException:
            continue
        text = data.decode("latin-1").strip("\0 ")
        identity[name] = f"0x{int.from_bytes(data, 'little'):08X}" if name in _NUMBERS else text
    return identity
