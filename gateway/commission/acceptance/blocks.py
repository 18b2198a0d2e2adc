"""The report's data as blocks of text and tables, from which page and paper are made alike."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

from gateway.commission.session import format_moment

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
    """A heading of level 1 (the report), 2 (a part of it) or 3 (within a part)."""

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


def blocks(data: Mapping[str, Any], digest: str) -> list[Block]:
    """The whole report; `digest` is the SHA-256 of its JSON file."""
    made, clock, audit, records = data["made"], data["clock"], data["audit"], data["records"]
    offset = clock["hmi_offset_s"]
    facts = (
        ("made", f"{format_moment(made['time'])} by {made['by']}"),
        ("device", "; ".join(data["places"]) or "none"),
        ("machine", ", ".join(data["machines"])),
        ("names", ", ".join(data["names"])),
        ("this machine's clock", clock["machine"]),
        ("the HMI's clock", f"{offset:+.3f} s ahead of this machine's" if offset else "not given"),
        ("versions", ", ".join(f"{name} {number}" for name, number in data["versions"].items())),
        ("data", f"report.json, SHA-256 {digest}"),
    )
    report: list[Block] = [
        Heading(f"Site acceptance report: {data['site']}"),
        Text(f"Result: {data['verdict']}", _STATES[data["verdict"]]),
        ReportTable(("what", "value"), facts, widths=(0.16, 0.84)),
        Heading("Open points", 2),
    ]
    points = tuple((str(number), point) for number, point in enumerate(data["open_points"], start=1))
    report.append(ReportTable(("no.", "what is open"), points, widths=(0.06, 0.94)) if points else Text("None."))

    report += [
        Heading("Checks", 2),
        Text("Of a check that was repeated the last one counts. The number is that of its record in the annex."),
    ]
    rows, states = [], []
    for check in data["checks"]:
        state = check["state"] if check["required"] or check["tries"] else "not asked for"
        number = "" if check["record"] is None else str(check["record"])
        what = (check["command"], check["shows"], state, number, str(check["tries"]))
        rows.append((*what, format_moment(check["time"]), check["who"], check["reason"]))
        states.append(_STATES.get(state, ""))
    columns = ("check", "what it shows", "result", "record", "tries", "time", "who", "reason")
    widths = (0.11, 0.22, 0.09, 0.06, 0.05, 0.14, 0.08, 0.25)
    report.append(ReportTable(columns, tuple(rows), tuple(states), widths))

    report.append(Heading("Writing", 2))
    # A report that was made before there were several blocks does not name them.
    if written := data.get("blocks"):
        of_each = tuple(
            (block["temperature"] or "not named", block["address"], str(block["words"])) for block in written
        )
        report.append(ReportTable(("block of", "from", "words"), of_each, widths=(0.5, 0.34, 0.16)))
    if not audit["rows"] and not audit["problem"]:
        report.append(Text("Nothing was armed and nothing was written: there is no audit log."))
    else:
        kinds = ", ".join(f"{count} {kind}" for kind, count in audit["kinds"].items())
        whole = audit["problem"] or "whole"
        armings = tuple(
            (
                str(row["row"]),
                format_moment(row["time"]),
                row["kind"],
                row["who"],
                row["reason"],
                format_moment(row["detail"].get("until")),
            )
            for row in audit["armings"]
        )
        heads = ("row", "time", "what", "who", "reason", "until")
        report += [
            Text(f"Audit log {audit['path']}: {audit['rows']} rows ({kinds}); its chain is {whole}."),
            Text(f"Newest hash: {audit['head']}. By signed heads {audit['end']}."),
            ReportTable(heads, armings, widths=(0.06, 0.18, 0.12, 0.14, 0.32, 0.18)),
        ]

    # Who signs has read what stands above; what follows is the annex: files of configuration, every record in full.
    report += [
        Heading("Signatures", 2),
        Text(
            f"Those who sign have seen this report. Its data has the SHA-256 {digest}; the seal that `decanter plc "
            "report` printed covers all files, and `decanter plc report --verify` checks them."
        ),
        Signatures(("commissioning engineer", "plant operator")),
        Heading("Annex: configuration", 2),
    ]
    files = tuple((file["path"], file["sha256"], "yes" if file["changed"] else "no") for file in data["configuration"])
    if files:
        named = ("file", "SHA-256 when last used", "changed since")
        report.append(ReportTable(named, files, widths=(0.36, 0.54, 0.1), mono=frozenset({1})))
    else:
        report.append(Text("No file of configuration was used."))
    chain = "whole" if records["broken_at"] is None else f"broken at line {records['broken_at']}"
    count = len(records["rows"])
    report += [
        Heading("Annex: records", 2),
        Text(f"{records['path']}: {count} records, chain {chain}, SHA-256 {records['sha256']}"),
    ]
    for record in records["rows"]:
        report += [Heading(f"{record['number']}. {record['command']}", 3), *_record(record)]
    return report


def _record(record: Mapping[str, Any]) -> Iterator[Block]:
    state = "bad" if record["code"] else "good"
    sentence = record["reason"] or ("in order" if not record["code"] else "")
    yield Text(f"Exit code {record['code']}: {sentence}" if sentence else f"Exit code {record['code']}", state)
    frames = record["frames"]
    facts = [
        (
            "when",
            f"{format_moment(record['time'])}, {record['seconds']:.2f} s, by {record['who']} on {record['machine']}",
        ),
        ("where", record["place"]),
        ("arguments", _cell(record["arguments"])),
        (
            "frames",
            f"{frames.get('sent', 0)} sent, {frames.get('received', 0)} received, {frames.get('bytes', 0)} bytes",
        ),
        ("raw frames", f"SHA-256 {frames.get('sha256', '')}"),
        *(("file", f"{path}, SHA-256 {digest}") for path, digest in record["configuration"].items()),
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
        cells = tuple(tuple(_cell(_moment(column, row.get(column))) for column in columns) for row in rows[:MOST_ROWS])
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


def _moment(name: str, value: object) -> object:
    """A time (s UTC) as a date for a person; any other value as it is."""
    return format_moment(value) if name == "time" and isinstance(value, float) and isfinite(value) else value


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
