"""`scan frames`: what is heard on a CAN bus, by identifier, and what each of them is likely to be. Nothing is sent."""

import time
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import mean, pstdev
from typing import Any

from drivers.can import Dbc, frame_key, frame_name
from drivers.survey import BusFrame, open_bus_survey
from gateway.commission.session import Site
from gateway.console import CommandResult
from gateway.entry import Exit

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
    async with open_bus_survey(site.target.driver, settings, clock=time.time) as survey:
        try:
            frames = await survey.listen(seconds)
        finally:
            site.count(survey.statistics())
    rows = rows_of(frames, seconds, names)
    data: dict[str, Any] = {"seconds": seconds, "heard": len(frames), "ids": rows}
    if bitrate := settings.get("bitrate"):
        from drivers.can.bus import frame_bits

        bits = sum(frame_bits(len(frame.data), extended=frame.extended) for frame in frames)
        data["load_percent"] = 100.0 * bits / (bitrate * seconds)
    sentence = f"no frame in {seconds:g} s: another bit rate, nobody on the bus, or a broken wire"
    return CommandResult(data, "" if frames else sentence, Exit.TIMEOUT)


def rows_of(frames: Sequence[BusFrame], seconds: float, names: Mapping[int, str]) -> list[dict[str, Any]]:
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
                "what": names.get(key) or likely(heard[0], heartbeats),
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


def likely(frame: BusFrame, heartbeats: set[int]) -> str:
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
