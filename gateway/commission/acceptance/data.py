"""The site acceptance report as data: every check, its evidence, what is open; from the commands' own records."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from gateway.commission.session import CommandRecord, find_break, format_moment, read_records, versions
from gateway.machine.writing import uptime
from gateway.store import (
    ARMED,
    DISARMED,
    EXPIRED,
    WitnessPlaces,
    armed_subjects,
    end_reason,
    examine,
    given_words,
    public_path,
    read,
    sha256_hex,
    trusted_key,
)

FORMAT = 1
PASSED, OPEN, INCOMPLETE, FAILED = "passed", "passed with open points", "not complete", "failed"


@dataclass(frozen=True, slots=True)
class ReportCheck:
    """One row of the acceptance test: the command that does it, what it shows, and when it has to be done."""

    command: str
    shows: str
    required: str


CHECKS: tuple[ReportCheck, ...] = (
    ReportCheck("doctor", "this machine is fit: clock, network, files", "always"),
    ReportCheck("probe", "the device is there, answers, and says who it is", "always"),
    ReportCheck("scan registers", "what can be read, and how much at once", "never"),
    ReportCheck("import", "the tags are those of the I/O list", "never"),
    ReportCheck("check", "the configuration is in order", "always"),
    ReportCheck("plan", "one scan fits into its period", "always"),
    ReportCheck("verify", "the values are those of the HMI", "always"),
    ReportCheck("soak", "reading holds for a longer time", "always"),
    ReportCheck("plan --write", "the write map is closed and complete", "writing"),
    ReportCheck("test alarms", "every alarm bit gets through to the HMI", "writing"),
    ReportCheck("test heartbeat", "heartbeats and the PLC's timer work", "writing"),
    ReportCheck("test conformance", "the PLC's side keeps the write-back contract", "never"),
    ReportCheck("replay", "the gateway does with the recording what it did live", "never"),
)
"""The acceptance test, in the order of the commissioning hour."""

EARLIER_NAMES: dict[str, str] = {
    "plan --write": "write plan",
    "test alarms": "loop alarms",
    "test heartbeat": "loop heartbeat",
    "test conformance": "conformance",
}
"""Command -> its name in records that an earlier release appended; they count as the same."""

NOT_CARRIED_OUT = frozenset({2, 6, 130})
"""Exit codes of commands that came to no result: wrong usage, not armed, interrupted."""


def gather(
    records_path: Path, places: WitnessPlaces, *, site: str, by: str, now: float, remarks: Sequence[str] = ()
) -> dict[str, Any]:
    """The report's data. `places` are the audit log and its witnesses, `remarks` open points that a person adds.

    Raises RecordsError, AuditError or SigningKeyError for files that are damaged, OSError for records that are not
    there.
    """
    records = read_records(records_path)
    if not records:
        raise ValueError(f"{records_path}: holds no record; carry out the checks first, then make the report of them")
    writing = any(record.command == "arm" and not record.code for record in records)
    checks = [_evaluate_check(check, records, writing=writing) for check in CHECKS]
    chain = find_break(records_path)
    audit = _audit(places, now)
    configuration = _configuration(records)
    points: list[str] = []
    # The gravest first: what makes the records themselves doubtful, what failed, what is missing, what is merely open.
    if chain is not None:
        points.append(f"line {chain} of {records_path} does not follow the line before it: the records were changed")
    if audit["problem"]:
        points.append(f"the audit log is not whole: {audit['problem']}")
    if audit["standing"]:
        points.append(f"still armed: {audit['standing']}")
    failed = [check for check in checks if check["state"] == "failed"]
    missing = [check for check in checks if check["state"] == "not done" and check["required"]]
    points += [f"{check['command']} failed: {check['reason'] or 'see its record'}" for check in failed]
    points += [f"{check['command']} was not done: {check['shows']}" for check in missing]
    for check in checks:
        if check["record"] is not None and check["state"] == "passed":
            points += _open_points(check["command"], records[check["record"] - 1])
    for file in configuration:
        if file["changed"]:
            points.append(f"{file['path']} was changed after it was last used ({file['changed']})")
    points += remarks
    if failed or chain is not None or audit["problem"]:
        result = FAILED
    elif missing:
        result = INCOMPLETE
    else:
        result = OPEN if points else PASSED
    return {
        "format": FORMAT,
        "site": site,
        "made": {"time": now, "by": by, "versions": versions()},
        "verdict": result,
        "checks": checks,
        "open_points": points,
        "clock": _clock(records),
        "names": sorted({record.who for record in records} | set(audit["names"])),
        "places": sorted({record.place for record in records if record.place}),
        "machines": sorted({record.machine for record in records}),
        "configuration": configuration,
        "versions": records[-1].versions,
        "blocks": _blocks(records),
        "audit": audit,
        "records": {
            "path": str(records_path),
            "sha256": sha256_hex(records_path.read_bytes()),
            "broken_at": chain,
            "rows": [{"number": number, **asdict(record)} for number, record in enumerate(records, start=1)],
        },
    }


def _blocks(records: Sequence[CommandRecord]) -> list[dict[str, Any]]:
    """The blocks of the newest `plan --write`: which temperature each speaks of, where it begins, how long it is."""
    planned = [record for record in records if record.command in ("plan --write", EARLIER_NAMES["plan --write"])]
    words = _dicts(planned[-1].result.get("words")) if planned else []
    of_each: dict[str, list[Mapping[str, Any]]] = {}
    for word in words:
        of_each.setdefault(str(word.get("block", "")), []).append(word)
    return [
        {"temperature": name, "address": str(own[0].get("address", "")), "words": len(own)}
        for name, own in of_each.items()
    ]


def _evaluate_check(check: ReportCheck, records: Sequence[CommandRecord], *, writing: bool) -> dict[str, Any]:
    """The newest record of a check that came to a result is the one that counts."""
    own = [
        (number, record)
        for number, record in enumerate(records, start=1)
        if record.command in (check.command, EARLIER_NAMES.get(check.command)) and record.code not in NOT_CARRIED_OUT
    ]
    required = check.required == "always" or (check.required == "writing" and writing)
    row: dict[str, Any] = {"command": check.command, "shows": check.shows, "required": required, "tries": len(own)}
    if not own:
        return {**row, "state": "not done", "record": None, "time": None, "who": "", "reason": ""}
    number, last = own[-1]
    state = "failed" if last.code else "passed"
    return {**row, "state": state, "record": number, "time": last.time, "who": last.who, "reason": last.reason}


def _open_points(command: str, record: CommandRecord) -> Iterator[str]:
    """What a check that passed has left open."""
    skipped = [row for row in _dicts(record.result.get("rows")) if row.get("skipped")]
    if skipped:
        yield f"{command}: {len(skipped)} steps could not be put, the first: {skipped[0].get('step', '')}"
    if command == "test alarms" and record.result.get("asked") is False:
        yield "test alarms: nobody was asked what the HMI shows (--ask)"
    if command == "test heartbeat" and record.result.get("watchdog") is False:
        yield "test heartbeat: the PLC's timer was left out (--no-watchdog)"
    points = [str(point) for point in record.result.get("open_points", [])]
    points += [
        str(step.get("sentence")) for step in _dicts(record.result.get("steps")) if step.get("state") == "warning"
    ]
    for point in dict.fromkeys(points):
        yield point if point.startswith(f"{command}:") else f"{command}: {point}"


def _configuration(records: Sequence[CommandRecord]) -> list[dict[str, Any]]:
    """Each file that was used, with its newest recorded hash, and whether it has another one now."""
    newest: dict[str, tuple[str, float]] = {}
    for record in records:
        newest |= {path: (digest, record.time) for path, digest in record.configuration.items()}
    rows = []
    for path, (digest, moment) in sorted(newest.items()):
        file = Path(path)
        now = sha256_hex(file.read_bytes()) if file.is_file() else "is no longer there"
        rows.append({"path": path, "sha256": digest, "used": moment, "changed": "" if now == digest else now})
    return rows


def _clock(records: Sequence[CommandRecord]) -> dict[str, Any]:
    """What doctor says of this machine's clock, and by how much the HMI's was ahead of it by the newest `verify`."""
    sentence, offset = "not looked at (decanter plc check computer)", None
    for record in records:
        for step in _dicts(record.result.get("steps")):
            if record.command == "doctor" and step.get("step") == "clock":
                sentence = str(step.get("sentence", ""))
        if record.command == "verify":
            ahead = {**record.arguments, **record.result}.get("clock_offset")
            offset = float(ahead) if isinstance(ahead, int | float) else offset
    return {"machine": sentence, "hmi_offset_s": offset}


def _dicts(value: object) -> list[Mapping[str, Any]]:
    return [row for row in value if isinstance(row, dict)] if isinstance(value, list) else []


def _audit(places: WitnessPlaces, now: float) -> dict[str, Any]:
    """What the audit log says, and whether it is whole by the witness of its signed heads."""
    path = places.audit
    empty: dict[str, Any] = {
        "path": str(path),
        "rows": 0,
        "head": "",
        "problem": "",
        "end": "",
        "kinds": {},
        "armings": [],
    }
    if not path.exists() and not places.heads.exists():
        return {**empty, "standing": "", "names": []}
    public = public_path(places.key)
    checked = examine(places, public=trusted_key(places, public if public.exists() else None))
    rows = [] if checked.broken else read(path)
    armings = [{"row": row.id, **asdict(row.entry)} for row in rows if row.entry.kind in (ARMED, DISARMED, EXPIRED)]
    # Confirmed or not: what looks armed is a point to look at, and to see that needs no key.
    standing = []
    for subject in [] if checked.broken else armed_subjects(path):
        row = next(iter(given_words(path, subject=subject)), None)
        if row is not None and row.entry.kind == ARMED and not end_reason(path, row, now, uptime()):
            about = f"{subject}: " if subject else ""
            standing.append(
                f"{about}by {row.entry.who} ({row.entry.reason}) until {format_moment(row.entry.detail['until'])}"
            )
    return {
        **empty,
        "rows": checked.rows,
        "head": checked.head,
        "problem": checked.problem,
        "end": checked.end,
        "kinds": dict(Counter(row.entry.kind for row in rows)),
        "armings": armings,
        "standing": "; ".join(standing),
        "names": sorted({row["who"] for row in armings if row["who"]}),
    }
