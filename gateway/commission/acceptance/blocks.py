"""The report's data as blocks of text and tables, from which page and paper are made alike."""

import json
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

MOST_ROWS = 400
_LONGEST = 160
_STATES = {
    "passed": "good",
    "passed with open points": "open",
    "not complete": "open",
    "not done": "open",
    "failed": "bad",
}


@dataclass(frozen=True, slots=True)
class Heading:
    """A heading of level 1 or 2."""

    text: str
    level: int = 1


@dataclass(frozen=True, slots=True)
class Text:
    """A paragraph; `state` is "good", "bad", "open" or "" and colours it."""

    text: str
    state: str = ""


@dataclass(frozen=True, slots=True)
class ReportTable:
    """A table. `states` colours each row as `Text.state` does; `widths` are shares of the paper's width.

    `mono` are the columns of hashes and addresses.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    states: tuple[str, ...] = ()
    widths: tuple[float, ...] = ()
    mono: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class Signatures:
    """Lines to sign on."""

    roles: tuple[str, ...]


Block = Heading | Text | ReportTable | Signatures


def at(moment: float | None) -> str:
    """A moment (s UTC) for a person."""
    return "" if moment is None else time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(moment))


def blocks(data: Mapping[str, Any], digest: str) -> list[Block]:
    """The whole report; `digest` is the SHA-256 of its JSON file."""
    return [*_front(data, digest), *_checks(data), *_audit(data), *_evidence(data, digest)]


def _front(data: Mapping[str, Any], digest: str) -> Iterator[Block]:
    making, clock = data["made"], data["clock"]
    yield Heading(f"Site acceptance report: {data['site']}")
    yield Text(f"Result: {data['verdict']}", _STATES[data["verdict"]])
    offset = clock["hmi_offset_s"]
    hmi = f"{offset:+.3f} s ahead of this machine's" if offset else "not given"
    facts = [
        ("made", f"{at(making['time'])} by {making['by']}"),
        ("device", "; ".join(data["places"]) or "none"),
        ("machine", ", ".join(data["machines"])),
        ("names", ", ".join(data["names"])),
        ("this machine's clock", clock["machine"]),
        ("the HMI's clock", hmi),
        ("versions", ", ".join(f"{name} {number}" for name, number in data["versions"].items())),
        ("data", f"report.json, SHA-256 {digest}"),
    ]
    yield ReportTable(("what", "value"), tuple(facts), widths=(0.16, 0.84))
    yield Heading("Open points", 2)
    if not data["open_points"]:
        yield Text("None.")
    else:
        rows = tuple((str(number), point) for number, point in enumerate(data["open_points"], start=1))
        yield ReportTable(("no.", "what is open"), rows, widths=(0.06, 0.94))


def _checks(data: Mapping[str, Any]) -> Iterator[Block]:
    yield Heading("Checks", 2)
    yield Text("Of a check that was repeated the last one counts. The number is that of its record below.")
    rows, states = [], []
    for check in data["checks"]:
        state = check["state"] if check["required"] or check["tries"] else "not asked for"
        rows.append(
            (
                check["command"],
                check["shows"],
                state,
                "" if check["record"] is None else str(check["record"]),
                str(check["tries"]),
                at(check["time"]),
                check["who"],
                check["reason"],
            )
        )
        states.append(_STATES.get(state, ""))
    columns = ("check", "what it shows", "result", "record", "tries", "time", "who", "reason")
    yield ReportTable(columns, tuple(rows), tuple(states), (0.11, 0.22, 0.09, 0.06, 0.05, 0.14, 0.08, 0.25))


def _audit(data: Mapping[str, Any]) -> Iterator[Block]:
    audit = data["audit"]
    yield Heading("Writing", 2)
    if not audit["rows"]:
        yield Text("Nothing was armed and nothing was written: there is no audit log.")
        return
    kinds = ", ".join(f"{count} {kind}" for kind, count in audit["kinds"].items())
    whole = audit["problem"] or "whole"
    yield Text(f"Audit log {audit['path']}: {audit['rows']} rows ({kinds}); its chain is {whole}.")
    yield Text(f"Newest hash: {audit['head']}")
    rows = tuple(
        (
            str(arming["row"]),
            at(arming["time"]),
            arming["kind"],
            arming["who"],
            arming["reason"],
            at(arming["detail"].get("until")),
        )
        for arming in audit["armings"]
    )
    widths = (0.06, 0.18, 0.12, 0.14, 0.32, 0.18)
    yield ReportTable(("row", "time", "what", "who", "reason", "until"), rows, widths=widths)


def _evidence(data: Mapping[str, Any], digest: str) -> Iterator[Block]:
    """The files of configuration, every record in full, and the lines to sign on."""
    yield Heading("Configuration", 2)
    rows = [(file["path"], file["sha256"], "yes" if file["changed"] else "no") for file in data["configuration"]]
    if rows:
        widths, mono = (0.36, 0.54, 0.1), frozenset({1})
        yield ReportTable(("file", "SHA-256 when last used", "changed since"), tuple(rows), widths=widths, mono=mono)
    else:
        yield Text("No file of configuration was used.")
    yield Heading("Records", 2)
    records = data["records"]
    chain = "whole" if records["broken_at"] is None else f"broken at line {records['broken_at']}"
    yield Text(f"{records['path']}: {len(records['rows'])} records, chain {chain}, SHA-256 {records['sha256']}")
    for record in records["rows"]:
        yield Heading(f"{record['number']}. {record['command']}", 2)
        yield from _record(record)
    yield Heading("Signatures", 2)
    yield Text(
        f"Those who sign have seen this report. Its data has the SHA-256 {digest}; the seal that `decanter plc report` "
        "printed covers all files, and `decanter plc report --verify` checks them."
    )
    yield Signatures(("commissioning engineer", "plant operator"))


def _record(record: Mapping[str, Any]) -> Iterator[Block]:
    state = "bad" if record["code"] else "good"
    sentence = record["reason"] or ("in order" if not record["code"] else "")
    yield Text(f"Exit code {record['code']}: {sentence}" if sentence else f"Exit code {record['code']}", state)
    frames = record["frames"]
    facts = [
        ("when", f"{at(record['time'])}, {record['seconds']:.2f} s, by {record['who']} on {record['machine']}"),
        ("where", record["place"]),
        ("arguments", _cell(record["arguments"])),
        (
            "frames",
            f"{frames.get('sent', 0)} sent, {frames.get('received', 0)} received, {frames.get('bytes', 0)} bytes",
        ),
        ("raw frames", f"SHA-256 {frames.get('sha256', '')}"),
        *((f"file {path}", f"SHA-256 {digest}") for path, digest in record["configuration"].items()),
    ]
    # Of the result a list of objects is a table of its own, everything else a row of the facts.
    tables: dict[str, list[Mapping[str, Any]]] = {}
    for name, value in record["result"].items():
        if isinstance(value, list) and value and all(isinstance(row, dict) for row in value):
            tables[name] = value
        elif value not in (None, "", [], {}):
            facts.append((name, _cell(value)))
    shown = tuple((name, value) for name, value in facts if value)
    yield ReportTable(("what", "value"), shown, widths=(0.2, 0.8))
    for name, rows in tables.items():
        yield Text(f"{name} ({len(rows)})")
        columns = tuple(dict.fromkeys(key for row in rows for key in row))
        cells = tuple(tuple(_cell(row.get(column)) for column in columns) for row in rows[:MOST_ROWS])
        states = []
        for row in rows[:MOST_ROWS]:
            state = {"ok": "good", "failed": "bad", "warning": "open"}.get(str(row.get("state")), "")
            for key in ("passed", "ok"):
                if isinstance(row.get(key), bool):
                    state = "good" if row[key] else "bad"
            states.append("open" if row.get("skipped") else state)
        # Shares of the width by the longest text of each column, so that no word has to be broken without need. The
        # power below 1 takes from the long columns what the short ones need: text wraps, numbers do not.
        longest = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
        wanted = [min(max(length, 4), 60) ** 0.75 for length in longest]
        widths = tuple(share / sum(wanted) for share in wanted)
        yield ReportTable(columns, cells, tuple(states), widths)
        if len(rows) > MOST_ROWS:
            yield Text(f"The first {MOST_ROWS} of {len(rows)} are shown; report.json has them all.")


def _cell(value: object) -> str:
    """A value in a table: short, for a person; the JSON file has it in full."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}" if isfinite(value) else "not known"
    if isinstance(value, Mapping):
        text = ", ".join(f"{key} {_cell(inner)}" for key, inner in value.items() if inner not in (None, "", [], {}))
    elif isinstance(value, list | tuple):
        text = ", ".join(map(_cell, value))
    else:
        text = value if isinstance(value, str) else json.dumps(value, default=str)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
