"""The control channel: one JSON object a line in, one a line out; on stdin and stdout, on a loopback port, or both.

    {"command": "seek", "position": 120.0, "id": 7}
    {"event": "reply", "id": 7, "command": "seek", "ok": true, "position": 120.0, ...}

`id` is optional and comes back as it was. A command that cannot be done answers `"ok": false` and one sentence in
`error`; nothing has changed then. What a command changes is in the image after the next cycle. The commands are the
keys of COMMANDS; `describe` lists them with their keys.

Where the process is several machines, the key `machine` says which one is meant; without it a command is for all of
them, and the reply holds `machines`: each one's own.
"""

import asyncio
import os
import threading
from collections.abc import Callable, Mapping

from drivers import json_lines
from drivers.json_lines import NoObject
from sim.plc.program import (
    BlockLayout,
    InputError,
    Intake,
    Plc,
    TraceReplay,
    checked_arguments,
    keyword_signature,
    list_words,
    parse_fault,
    plant_status,
    unusable,
)

Outcome = dict[str, object]
_MAX_LINE_BYTES = 65536
_OF_A_REPLY = frozenset({"event", "id", "command"})


def _replay(plc: Plc) -> TraceReplay:
    if plc.replay is None:
        raise InputError("there is no trace to replay; start with --trace FILE")
    return plc.replay


def _report_position(plc: Plc, now: float) -> Outcome:
    replay = _replay(plc)
    place = {
        "position": replay.row_position(now),
        "row": replay.row(now),
        "held": replay.held,
        "ended": replay.at_end(now),
    }
    ways = {"speed": replay.rate, "loop": replay.loop, "duration": replay.table.duration}
    return {**place, **ways, "plant_time": plc.clock.plant_time(now)}


def _start(plc: Plc, now: float) -> Outcome:
    """Let a held replay run; the schedule of faults counts from the first start."""
    plc.start(now)
    return _report_position(plc, now) if plc.replay else {}


def _pause(plc: Plc, now: float) -> Outcome:
    """Hold the replay at its position; the heartbeat goes on."""
    plc.replay = _replay(plc).change(now, held=True)
    return _report_position(plc, now)


def _resume(plc: Plc, now: float) -> Outcome:
    """Go on from where the replay was held."""
    plc.replay = _replay(plc).change(now, held=False)
    return _report_position(plc, now)


def _seek(plc: Plc, now: float, *, position: float) -> Outcome:
    """Go to a position, in seconds from the trace's first row; a live plant goes nowhere but on."""
    if plc.plant is not None:
        raise InputError("a live plant only goes on; start another one, or replay a trace")
    plc.replay = _replay(plc).seek(now, position)
    plc.ended = False
    return _report_position(plc, now)


def _speed(plc: Plc, now: float, *, speed: float) -> Outcome:
    """Replay so many trace seconds a second. Plant time keeps the speed of the ready line: others run on it."""
    if speed <= 0:
        raise InputError(f"key 'speed': {speed:g} is not positive; give trace seconds per second")
    plc.replay = _replay(plc).change(now, rate=speed)
    return _report_position(plc, now)


def _loop(plc: Plc, now: float, *, on: bool) -> Outcome:
    """Begin again at the end of the trace, or stay there."""
    if on and plc.plant is not None:
        raise InputError("a live plant does not begin again; start another one, or replay a trace")
    plc.replay = _replay(plc).change(now, loop=on)
    plc.ended = False
    return _report_position(plc, now)


def _fault(plc: Plc, now: float, *, fault: dict[str, object]) -> Outcome:
    """Order a fault, as in a file of faults but with `start` counted from now; gives its number."""
    parsed = parse_fault(fault, "key 'fault'")
    plc.check_fault(parsed)
    return {"number": plc.schedule.add(parsed, now)}


def _clear(plc: Plc, now: float, *, number: int | None = None) -> Outcome:
    """End one fault, or all that are in force or to come."""
    return {"numbers": plc.schedule.clear(number)}


def _permit(plc: Plc, now: float, *, on: bool) -> Outcome:
    """Give or take the gateway's write permit."""
    plc.permit = on
    return {"permit": on}


def _acknowledge(plc: Plc, now: float, *, bits: int, block: str = "") -> Outcome:
    """Set the word of acknowledge bits; `block` is a further block's suffix, for its own word."""
    if not 0 <= bits <= 0xFFFF:
        raise InputError(f"key 'bits': {bits} is no word; give 0 to 65535")
    if block not in plc.acknowledged:
        raise InputError(f"key 'block': there is no block {block!r}; known are {list_words(tuple(plc.acknowledged))}")
    plc.acknowledged[block] = bits
    return {"bits": bits}


def _force(plc: Plc, now: float, *, tag: str, value: bool | int | float | str | None) -> Outcome:
    """Hold a tag at a value whatever the trace says; null: "not available"."""
    plc.force(tag, value)
    return {"tag": tag, "value": value}


def _release(plc: Plc, now: float, *, tag: str | None = None) -> Outcome:
    """Let one forced tag, or all, follow the trace again."""
    return {"tags": plc.release(tag, now)}


def _feed(plc: Plc, now: float, *, share: float) -> Outcome:
    """Give a live plant this share (0 to 1) of its feed, as an operator would; a reduced one stays until then."""
    if plc.plant is None:
        raise InputError("there is no live plant; start with --plant NAME")
    if not 0 <= share <= 1:
        raise InputError(f"key 'share': {share:g} is no share; give 0 to 1")
    plc.plant.feed = share
    return {"feed": share}


def _status(plc: Plc, now: float) -> Outcome:
    """Where the replay is, what the PLC makes of the gateway, which faults are ordered."""
    blocks = [
        _account(plc, now, layout, intake, usable)
        for layout, intake, usable in zip(plc.layouts, plc.intakes, plc.usables, strict=True)
    ]
    verdict = {"permit": plc.permit, "acknowledged": plc.acknowledged[""]}
    faults = [
        {"number": entry.number, "kind": entry.fault.kind, "in_force": entry.in_force(now), "hits": entry.hits}
        for entry in plc.schedule.entries
    ]
    program = {"running": plc.running, "heartbeat": plc.heartbeat, "version": plc.image.version}
    own = {
        **program,
        "connections": plc.connections,
        "forced": dict(plc.forced),
        "faults": faults,
        "plant": plant_status(plc.plant),
    }
    return {
        **(_report_position(plc, now) if plc.replay else {"plant_time": plc.clock.plant_time(now)}),
        **own,
        **blocks[0],
        **verdict,
        "blocks": blocks,
    }


def _account(plc: Plc, now: float, layout: BlockLayout | None, intake: Intake, usable: bool) -> dict[str, object]:
    """What the PLC makes of one block."""
    why = "" if layout is None or usable else unusable(layout, intake, now, plc.permit)
    return {
        "temperature": layout.temperature if layout else "",
        "suffix": layout.suffix if layout else "",
        "accepted": intake.accepted,
        "refused": intake.refused,
        "last_refusal": intake.last_refusal,
        "usable": usable,
        "unusable": why,
        "block": dict(intake.block),
        "challenge": intake.challenge,
        "writers": {"session": intake.session.writer if intake.session else 0, "refused": intake.refused_writer},
    }


def _values(plc: Plc, now: float) -> Outcome:
    """The true value of every tag, null where the PLC has none."""
    return {"plant_time": plc.clock.plant_time(now), "values": dict(plc.image.truth)}


def _stop(plc: Plc, now: float) -> Outcome:
    """Stop cleanly, as SIGTERM does."""
    plc.stopping = True
    return {}


COMMANDS: dict[str, Callable[..., Outcome]] = {
    "start": _start,
    "pause": _pause,
    "resume": _resume,
    "seek": _seek,
    "speed": _speed,
    "loop": _loop,
    "fault": _fault,
    "clear": _clear,
    "permit": _permit,
    "acknowledge": _acknowledge,
    "force": _force,
    "release": _release,
    "feed": _feed,
    "status": _status,
    "values": _values,
    "stop": _stop,
}


def describe() -> str:
    """Every command with its keys and what it does, as the documentation prints them (Markdown)."""
    rows = [
        f"| `{name}` | {list_words(keyword_signature(function))} | {(function.__doc__ or '').splitlines()[0]} |"
        for name, function in COMMANDS.items()
    ]
    return "\n".join(("| command | keys | what the PLC does |", "|---|---|---|", *rows))


def obey(plc: Plc, line: str | bytes, now: float) -> Outcome:
    """Do what a line says and give the reply; a line that makes no sense is answered, never raised."""
    number, name = None, None
    try:
        order = json_lines.parse_object(line)
        number, name = order.pop("id", None), order.pop("command", None)
        function = COMMANDS.get(name) if isinstance(name, str) else None
        if function is None:
            raise InputError(f"key 'command': there is no {name!r}; known are {list_words(tuple(COMMANDS))}")
        outcome = function(plc, now, **checked_arguments(function, order, f"command {name!r}"))
    except (NoObject, InputError) as error:
        return {"event": "reply", "id": number, "command": name, "ok": False, "error": str(error)}
    # What only asks leaves no trace in the recording.
    if function not in (_status, _values):
        plc.event("command", now, {"command": name, **order})
    return {"event": "reply", "id": number, "command": name, "ok": True, **outcome}


def obey_machine(machines: Mapping[str, Plc], line: str | bytes, now: float) -> Outcome:
    """As `obey`, for the machine that the line names, or for all of them. One without a name is obeyed as it is."""
    if "" in machines:
        return obey(machines[""], line, now)
    try:
        order = json_lines.parse_object(line)
    except NoObject as error:
        return {"event": "reply", "id": None, "command": None, "ok": False, "error": str(error)}
    name = order.pop("machine", None)
    if name is None:
        replies = {name: obey(plc, json_lines.format_object(order), now) for name, plc in machines.items()}
        ok = all(reply["ok"] for reply in replies.values())
        own = {name: {key: reply[key] for key in reply if key not in _OF_A_REPLY} for name, reply in replies.items()}
        reply = {"event": "reply", "id": order.get("id"), "command": order.get("command"), "ok": ok, "machines": own}
        return reply if ok else {**reply, "error": next(str(r["error"]) for r in replies.values() if not r["ok"])}
    if not isinstance(name, str) or name not in machines:
        unknown = f"key 'machine': there is no {name!r}; known are {list_words(tuple(machines))}"
        return {"event": "reply", "id": order.get("id"), "command": order.get("command"), "ok": False, "error": unknown}
    return {**obey(machines[name], json_lines.format_object(order), now), "machine": name}


def say(message: Mapping[str, object]) -> None:
    """One line on stdout, unbuffered; silently nowhere when nobody reads it any more."""
    try:
        os.write(1, json_lines.format_object(message))
    except OSError:
        return


def listen_to_stdin(machines: Mapping[str, Plc], loop: asyncio.AbstractEventLoop) -> None:
    """Obey the lines of stdin from a thread of its own; the end of stdin stops the PLC."""

    def obey_line(line: bytes) -> None:
        say(obey_machine(machines, line, next(iter(machines.values())).clock.monotonic()))

    def stop() -> None:
        for plc in machines.values():
            plc.stopping = True

    def listen() -> None:
        rest = b""
        while data := os.read(0, _MAX_LINE_BYTES):
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                if line.strip() and not loop.is_closed():
                    loop.call_soon_threadsafe(obey_line, line)
            if len(rest) > _MAX_LINE_BYTES:
                break
        if not loop.is_closed():
            loop.call_soon_threadsafe(stop)

    threading.Thread(target=listen, name="stdin", daemon=True).start()


async def listen_on_loopback(machines: Mapping[str, Plc], port: int) -> asyncio.Server:
    """Obey the lines of every connection to 127.0.0.1:port. Raises OSError."""

    async def answer(line: bytes) -> Outcome:
        return obey_machine(machines, line, next(iter(machines.values())).clock.monotonic())

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await json_lines.serve(reader, writer, answer)

    return await asyncio.start_server(serve, "127.0.0.1", port, limit=_MAX_LINE_BYTES)
