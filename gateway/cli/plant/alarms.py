"""The commands of `decanter alarm`: asked of the running gateway, or read from its historian."""

import getpass
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from gateway.cli.plant.plant_file import control_socket
from gateway.console import CommandResult, Part, Rows, conclude
from gateway.entry import Exit, fail, sentences
from gateway.machine.alarms import (
    BY_PERSONS,
    LETTERS,
    MEANINGS,
    AlarmState,
    Change,
)
from gateway.outside.status import ControlError, GatewayLine, connect
from gateway.settings import ALARM_KINDS, OF_PLANT, alarm_subject, load_plant

PATIENCE_S = 15.0
"""What hides an alarm waits until it is on record."""


def _gateway(socket: Path, path: Path, machine: str | None = None) -> GatewayLine:
    """The gateway that runs with a plant file, at its socket, to be closed; leaves with a sentence where none runs."""
    if (line := connect(socket, PATIENCE_S, machine=machine)) is None:
        fail(f"no gateway runs with {path} (nothing answers at {socket})", Exit.CANNOT_CONNECT)
    return line


def _machines(socket: Path, path: Path) -> list[str]:
    """The names of the running gateway's machines, in its order: the file may have changed meanwhile."""
    with closing(_gateway(socket, path)) as line:
        return list(line.ask("plant")["statuses"])


def _ask_alarms(path: Path, machine: str | None) -> dict[str, list[dict[str, Any]]]:
    """The alarms by machine, of the one named or of all."""
    socket = control_socket(path, None)
    names = [machine] if machine is not None else _machines(socket, path)
    found: dict[str, list[dict[str, Any]]] = {}
    for name in names:
        line = _gateway(socket, path, name)
        try:
            found[name] = line.ask("alarms")["alarms"]
        except ControlError as error:
            fail(str(error), Exit.CHECK_FAILED)
        finally:
            line.close()
    return found


def _date(seconds: float | None) -> str:
    return "–" if seconds is None else datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%d %H:%M:%S")


def list_alarms(path: Path, machine: str | None, every: bool, as_json: bool) -> None:
    """The work of `alarm list`."""
    with sentences():
        found = _ask_alarms(path, machine)
    rows = [
        {"machine": name, **row}
        for name, alarms in found.items()
        for row in alarms
        if every or row["state"] != AlarmState.NORMAL
    ]
    urgent = [row for row in rows if row["active"] or Change.ACKNOWLEDGE in row["possible"]]

    def show_rows() -> Iterator[Part]:
        cells = [
            [
                row["priority"],
                *([alarm_subject(row["name"], row["tag"], row["machine"])] if len(found) > 1 else []),
                ("first: " if row["first_up"] else "") + row["name"],
                row["state"] + (f" until {_date(row['until'])}" if row["until"] else ""),
                _date(row["since"]),
                row["response"] if row["active"] else row["reason"],
            ]
            for row in rows
        ]
        head = ("", *(("machine",) if len(found) > 1 else ()), "alarm", "state", "since", "what to do, or why")
        yield Rows(f"{len(urgent)} to be dealt with, {len(rows)} in all", head, cells)

    conclude(CommandResult({"alarms": rows}, ok=not urgent), lambda _: show_rows(), as_json=as_json)


def show(name: str, path: Path, machine: str | None, as_json: bool) -> None:
    """The work of `alarm show`."""
    with sentences():
        found = _ask_alarms(path, machine)
    rows = [{"machine": each, **row} for each, alarms in found.items() for row in alarms if row["name"] == name]
    if not rows:
        known = sorted({row["name"] for alarms in found.values() for row in alarms})
        fail(f"there is no alarm {name!r}; there are {', '.join(known)}")

    def show_rows() -> Iterator[Part]:
        for row in rows:
            state, kind = AlarmState(row["state"]), ALARM_KINDS.get(row["kind"])
            lines = {
                "alarm": f"{name} ({alarm_subject(name, row['tag'], row['machine'])}), priority {row['priority']}",
                "state": f"{LETTERS[state]} {state}: {MEANINGS[state]}",
                "since": _date(row["since"]) + (f", by {row['by']}: {row['reason']}" if row["by"] else ""),
                "until": _date(row["until"]) if row["until"] else "",
                "stands": ("yes" if row["standing"] else "no")
                + (f", last raised {_date(row['raised'])}" if row["raised"] else ""),
                "acknowledged by": row["acknowledged_by"],
                "watches": kind.watches if kind else "",
                "NAMUR NE 107": kind.namur if kind else "",
                "what to do": row["response"],
                "otherwise": row["consequence"],
                "can be done": ", ".join(row["possible"]),
            }
            for title, text in lines.items():
                if text:
                    yield f"{title + ':':<17}{text}"

    conclude(CommandResult({"alarms": rows}), lambda _: show_rows(), as_json=as_json)


def change(
    wanted: Change, *, path: Path, machine: str | None, names: Sequence[str], as_json: bool, by: str, **keys: Any
) -> None:
    """The work of what a person does with alarms: ask the running gateway for a change, and say what became of it."""
    with sentences():
        socket = control_socket(path, None)
        if machine is None and set(names) <= OF_PLANT and names:
            machine = _machines(socket, path)[0]  # which looks after the plant's: nobody has to know which one that is
        line = _gateway(socket, path, machine)
        try:
            answer = line.ask(wanted.value, alarms=list(names), by=by or getpass.getuser(), **keys)
        except ControlError as error:
            fail(str(error), Exit.CHECK_FAILED)
        finally:
            line.close()
    states: dict[str, str] = answer["alarms"]

    def show_states() -> Iterator[Part]:
        for name, state in states.items():
            yield f"{name}: {BY_PERSONS[wanted]}, now {state}"
        if not states:
            yield "no alarm waits for an acknowledgement"

    conclude(CommandResult({"alarms": states}), lambda _: show_states(), as_json=as_json)


def _window(path: Path, since: str, machine: str | None) -> tuple[Path, float, float]:
    """The historian, and the times (s UTC) from `since` to its newest scan."""
    from gateway.store import newest_scan, parse_moment, reading  # loads numpy, which the other commands do without

    historian = load_plant(path)[0].historian.path
    named = [machine] if machine is not None else [config.machine for config in load_plant(path)]
    with reading(historian) as connection:
        newest = [newest_scan(connection, machine=name if len(named) > 1 else machine) for name in named]
    end = max((time for time in newest if time is not None), default=None)
    if end is None:
        raise ValueError(f"{historian}: has no scan yet; let the gateway run first")
    return historian, parse_moment(since, end), end


def journal(since: str, path: Path, machine: str | None, as_json: bool) -> None:
    """The work of `alarm journal`."""
    from gateway.machine.alarms import read_journal

    with sentences():
        historian, start, _ = _window(path, since, machine)
        rows = read_journal(historian, machine=machine, start=start)

    def show_rows() -> Iterator[Part]:
        several = len({row.subject for row in rows}) > 1
        cells = [
            [
                _date(row.time),
                *([row.subject] if several else []),
                row.alarm,
                row.state,
                "–" if row.value is None else f"{row.value:g}",
                f"{row.by}: {row.reason}" if row.reason else row.by,
            ]
            for row in rows
        ]
        head = ("time", *(("machine",) if several else ()), "alarm", "state", "value", "by")
        yield Rows(f"{len(rows)} changes since {_date(start)}", head, cells)

    conclude(CommandResult({"journal": [asdict(row) for row in rows]}), lambda _: show_rows(), as_json=as_json)


def rates(since: str, path: Path, machine: str | None, as_json: bool) -> None:
    """The work of `alarm rates`."""
    from gateway.machine.alarms import PRIORITIES, alarm_rates, read_journal

    with sentences():
        historian, start, end = _window(path, since, machine)
        found = alarm_rates(read_journal(historian, machine=machine, end=end + 1e-6), start, end)

    def show_rates() -> Iterator[Part]:
        cells: list[list[object]] = [
            ["alarms", found.announced, f"{_date(start)} to {_date(end)}"],
            ["in ten minutes, on average", f"{found.per_ten_minutes:.2f}", found.verdict],
            ["in ten minutes, at most", found.peak, _date(found.peak_at)],
            ["floods", len(found.floods), f"{found.flooded:.1%} of the time"],
            ["chattering", len(found.chattering), ", ".join(found.chattering) or "–"],
            ["standing", len(found.standing), ", ".join(found.standing) or "–"],
            ["stale (a day and more)", len(found.stale), ", ".join(found.stale) or "–"],
        ]
        cells += [
            [f"priority {priority}", found.priorities.get(priority, 0),
             f"{found.shares.get(priority, 0.0):.0%}, advised {advised:.0%}"]
            for priority, advised in PRIORITIES.items()
        ]  # fmt: skip
        cells += [[name, count, "most frequent"] for name, count in found.frequent.items()]
        yield Rows("alarms against EEMUA 191 and ISA-18.2", ("what", "count", ""), cells)
        yield from found.findings

    conclude(CommandResult(asdict(found), ok=found.ok), lambda _: show_rates(), as_json=as_json)
