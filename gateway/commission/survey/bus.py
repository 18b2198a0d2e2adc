"""A CAN bus: the steps of `probe`, which nodes `scan nodes` finds, and what `scan frames` hears and may be."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import mean, pstdev
from typing import Any

from drivers.can import Dbc, frame_key, frame_name
from drivers.errors import DeviceException, LinkDown, ReplyMismatch, ReplyTimeout
from drivers.survey import BusFrame, ListensToBus
from gateway.commission.session import CheckStep, Site, failed_step, ok, warning
from gateway.console import CommandResult, Progress
from gateway.entry import Exit

LISTEN_S = 1.5
SDO_S = 0.3
NODE_S = 0.06
HEARTBEAT = 0x700
STATES = {0: "booting", 4: "stopped", 5: "operational", 127: "pre-operational"}
_TEXTS = {"name": (0x1008, 0), "hardware": (0x1009, 0), "software": (0x100A, 0)}
_NUMBERS = {"device type": (0x1000, 0), "vendor": (0x1018, 1), "product": (0x1018, 2), "revision": (0x1018, 3)}
_NUMBERS |= {"serial": (0x1018, 4)}
_PINNED = ("vendor", "product", "revision", "serial")


async def probe_bus(site: Site, steps: list[CheckStep], facts: dict[str, Any]) -> None:
    """Open, listen, and with CANopen ask the node who it is. Without CANopen nothing is sent."""
    settings = site.target.settings
    try:
        async with site.bus() as survey:
            steps.append(ok("bus", f"{settings.get('interface', 'socketcan')} {settings['channel']} is open"))
            frames = await survey.listen(LISTEN_S)
            ids = {(frame.id, frame.extended) for frame in frames}
            facts["heard"], facts["ids"] = len(frames), len(ids)
            why = "another bit rate, no device on the bus, or one that speaks only when asked"
            silence = f"no frame in {LISTEN_S:g} s: {why}"
            if frames:
                steps.append(ok("traffic", f"{len(frames)} frames of {len(ids)} ids in {LISTEN_S:g} s"))
            elif site.target.capabilities.nodes:  # the node is asked next, and may answer
                steps.append(warning("traffic", silence))
            else:
                steps.append(failed_step("traffic", silence, ReplyTimeout(silence)))
            if site.target.capabilities.nodes:
                node = int(settings.get("node", 1))
                pinned = settings.get("identity") or {}
                if await _node(survey, node, frames, steps, facts):
                    _compare_pin(pinned, steps, facts)
    except LinkDown as error:
        hint = "is the interface there and up (ip link set can0 up type can bitrate ...)?"
        hint = hint if settings.get("interface", "socketcan") == "socketcan" else "is the hub or adapter there?"
        steps.append(failed_step("bus", f"{error}: {hint}", error))


async def _node(
    survey: ListensToBus, node: int, frames: list[BusFrame], steps: list[CheckStep], facts: dict[str, Any]
) -> bool:
    """Whether the node answers, and who it says it is."""
    beats = [frame for frame in frames if not frame.extended and frame.id == HEARTBEAT + node and frame.data]
    if beats:
        state = beats[-1].data[0] & 0x7F  # bit 7 is the toggle bit of node guarding (CiA 301)
        steps.append(ok("heartbeat", f"node {node} is {STATES.get(state, f'in state {state}')}"))
    else:
        steps.append(warning("heartbeat", f"node {node} sent no heartbeat in {LISTEN_S:g} s (object 0x1017 may be 0)"))
    try:
        facts["identity"] = await read_identity(survey, node)
    except ReplyTimeout as error:
        others = sorted({frame.id - HEARTBEAT for frame in frames if HEARTBEAT < frame.id <= HEARTBEAT + 127})
        seen = f"; heartbeats come from node {', '.join(map(str, others))}: give --node" if others else ""
        steps.append(failed_step("node", f"node {node} answers no SDO request: wrong node, or it is off{seen}", error))
    except ReplyMismatch as error:
        steps.append(failed_step("node", str(error), error))
    else:
        steps.append(ok("node", ", ".join(f"{name} {value}" for name, value in facts["identity"].items())))
        return True
    return False


def _compare_pin(pinned: Mapping[str, int], steps: list[CheckStep], facts: dict[str, Any]) -> None:
    """Whether the node is the pinned one; what would pin it, where nothing does."""
    said = {name: int(facts["identity"][name], 16) for name in _PINNED if name in facts["identity"]}
    if wrong := [name for name, number in pinned.items() if said.get(name) != number]:
        name = wrong[0]
        heard = f"0x{said[name]:08X}" if name in said else "nothing"
        reason = f"another device: of its {name} it says {heard}, and 0x{pinned[name]:08X} is pinned (identity)"
        steps.append(failed_step("pinned", reason, LinkDown(reason)))
    elif pinned:
        steps.append(ok("pinned", "it is the pinned device"))
    elif said:
        facts["proposed_identity"] = said
        marks = ", ".join(f"{name} = {number}" for name, number in said.items())
        steps.append(ok("proposal", f"identity = {{ {marks} }} in [device] tells it from others"))


async def read_identity(survey: ListensToBus, node: int, timeout: float = SDO_S) -> dict[str, str]:
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


# ---------------------------------------------------------------- nodes


async def scan_nodes(site: Site, nodes: Sequence[int], progress: Progress, *, listen_only: bool) -> CommandResult:
    """The CANopen nodes of a bus: by their heartbeats, and unless `listen_only` by their answers to SDO requests."""
    async with site.bus() as survey:
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
            identity = await read_identity(survey, node) if answers else None
            if identity is not None or node in beats:
                state = beats.get(node)
                sentence = "no heartbeat" if state is None else STATES.get(state, f"state {state}")
                rows.append({"node": node, "heartbeat": sentence, "sdo": identity is not None, **(identity or {})})
    sentence = f"none of {len(nodes)} nodes: {len(frames)} frames were heard; check the bit rate and the wiring"
    return CommandResult({"nodes": rows, "asked": len(nodes)}, "" if rows else sentence, Exit.TIMEOUT)


# ---------------------------------------------------------------- frames

_CANOPEN: tuple[tuple[int, str], ...] = (
    (0x080, "EMCY of node {node}"),
    (0x180, "TPDO 1 of node {node}"),
    (0x200, "RPDO 1 of node {node}"),
    (0x280, "TPDO 2 of node {node}"),
    (0x300, "RPDO 2 of node {node}"),
    (0x380, "TPDO 3 of node {node}"),
    (0x400, "RPDO 3 of node {node}"),
    (0x480, "TPDO 4 of node {node}"),
    (0x500, "RPDO 4 of node {node}"),
    (0x580, "SDO answer of node {node}"),
    (0x600, "SDO request to node {node}"),
    (0x700, "heartbeat of node {node}"),
)
_ALONE = {0x000: "NMT", 0x080: "SYNC", 0x100: "TIME"}


async def scan_can(site: Site, seconds: float) -> CommandResult:
    """Listen for so long; one row an identifier."""
    settings = site.target.settings
    names: dict[int, str] = {}
    if settings.get("dbc"):
        names = {facts.key: name for name, facts in Dbc(Path(settings["dbc"])).messages.items()}
    async with site.bus() as survey:
        frames = await survey.listen(seconds)
    rows = identifier_rows(frames, seconds, names)
    data: dict[str, Any] = {"seconds": seconds, "heard": len(frames), "ids": rows}
    if bitrate := settings.get("bitrate"):
        from drivers.can.bus import frame_bits

        bits = sum(frame_bits(len(frame.data), extended=frame.extended) for frame in frames)
        data["load_percent"] = 100.0 * bits / (bitrate * seconds)
    sentence = f"no frame in {seconds:g} s: another bit rate, nobody on the bus, or a broken wire"
    return CommandResult(data, "" if frames else sentence, Exit.TIMEOUT)


def identifier_rows(frames: Sequence[BusFrame], seconds: float, names: Mapping[int, str]) -> list[dict[str, Any]]:
    """Each identifier with its rate, the period between its frames, its lengths, what moves in it, what it may be."""
    by_key: dict[int, list[BusFrame]] = {}
    for frame in frames:
        by_key.setdefault(frame_key(frame.id, extended=frame.extended), []).append(frame)
    # CANopen gives each node its identifiers by adding its number to a base (CiA 301); 0x700 is the heartbeat's.
    heartbeats = {frame.id - 0x700 for frame in frames if not frame.extended and 0x700 < frame.id <= 0x77F}
    rows = []
    for key, heard in sorted(by_key.items()):
        gaps = [1e3 * (later.time - former.time) for former, later in pairwise(heard)]
        # By place, the bytes that were seen there: those that were not always the same move.
        longest = max(len(frame.data) for frame in heard)
        columns = [{frame.data[at : at + 1] for frame in heard} for at in range(longest)]
        rows.append(
            {
                "id": frame_name(key),
                "what": names.get(key) or likely_meaning(heard[0], heartbeats),
                "frames": len(heard),
                "per_second": len(heard) / seconds,
                "period_ms": mean(gaps) if gaps else None,
                "jitter_ms": pstdev(gaps) if len(gaps) > 1 else None,
                "bytes": " ".join(map(str, sorted({len(frame.data) for frame in heard}))),
                "moves": " ".join(str(at) for at, seen in enumerate(columns) if len(seen) > 1),
                "last": heard[-1].data.hex(" "),
            }
        )
    return rows


def likely_meaning(frame: BusFrame, heartbeats: set[int]) -> str:
    """What an identifier is by the usual assignments: J1939, OBD-II, CANopen's predefined connection set.

    CANopen is believed only of nodes whose heartbeat was heard; a question mark says that nothing confirms it.
    """
    if frame.extended:
        # SAE J1939-21: below PDU format 240 the specific byte is the addressee, and no part of the group's number.
        pdu_format, specific = frame.id >> 16 & 0xFF, frame.id >> 8 & 0xFF
        pgn = (frame.id >> 8 & 0x3FF00) | (specific if pdu_format >= 240 else 0)
        return f"J1939? PGN {pgn} from {frame.id & 0xFF}"
    if 0x7E8 <= frame.id <= 0x7EF:
        return f"OBD-II? answer of unit {frame.id - 0x7E8}"
    if frame.id in _ALONE:
        return f"CANopen? {_ALONE[frame.id]}" if not heartbeats else f"CANopen {_ALONE[frame.id]}"
    node = frame.id & 0x7F
    text = dict(_CANOPEN).get(frame.id & ~0x7F)
    if text is None or not node:
        return ""
    return f"CANopen{'' if node in heartbeats else '?'} {text.format(node=node)}"
