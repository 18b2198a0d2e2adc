"""`decanter audit`: the account of every write, refusal and arming, whether it is whole, by whose witness."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from gateway.commission.options import SharedOptions
from gateway.commission.session import audit_path, format_moment
from gateway.console import CommandResult, Part, Rows, conclude
from gateway.entry import sentences
from gateway.machine.writing import find_places
from gateway.settings import Config, load_plant
from gateway.store import AuditRow, examine, numbered_files, read, trusted_key


def audit(
    given: SharedOptions,
    head: str,
    last: int,
    kinds: tuple[str, ...],
    public_key: Path | None,
    heads: Path | None,
    historian: Path | None,
    log: Path | None,
    audit: Path | None,
) -> None:
    """Carry out `decanter audit`; its options and its help are in commission/commands.py."""
    with sentences():
        configs = load_plant(given.plant) if given.plant is not None else ()
        places = find_places(audit_path(audit, given), configs[0] if configs else None)
        places = replace(
            places,
            heads=heads or places.heads,
            historian=historian or places.historian,
            logs=tuple(numbered_files(log)) if log is not None else places.logs,
        )
        verdict = examine(places, head=head, public=trusted_key(places, public_key))
        rows = [] if verdict.broken else read(places.audit, kinds)
        if given.machine is not None:
            rows = _of_machine(rows, given.machine, configs)
        rows = rows[-last:] if last else []
    plain = [{"id": row.id, **asdict(row.entry), "hash": row.hash} for row in rows]
    facts = {**asdict(verdict), "lost": verdict.lost and verdict.lost.head, "end": verdict.end}
    complaint = f"{places.audit}: {verdict.problem}" if verdict.problem else ""
    result = CommandResult({"path": str(places.audit), **facts, "entries": plain}, complaint)
    conclude(result, _view, as_json=given.as_json)


def _of_machine(rows: Sequence[AuditRow], machine: str, configs: Sequence[Config]) -> list[AuditRow]:
    """The rows about one machine, also of one that is gone from the plant file. Raises ValueError for no machine."""
    subjects = {config.machine: config.subject for config in configs}
    found = [row for row in rows if (row.entry.subject or "") == subjects.get(machine, machine)]
    if not found and machine not in subjects:
        known = ", ".join(dict.fromkeys([*subjects, *filter(None, (row.entry.subject for row in rows))]))
        raise ValueError(f"--machine {machine!r}: neither plant file nor audit log has it; they have {known or 'none'}")
    return found


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    title = f"{data['path']}: {data['rows']} rows, the chain is {'broken' if data['broken'] else 'whole'}"
    rows = [
        [entry["id"], format_moment(entry["time"]), entry["kind"], entry["who"], entry["reason"]]
        for entry in data["entries"]
    ]
    yield Rows(title, ("row", "time", "kind", "who", "reason"), rows)
    yield f"head: {data['head']}"
    yield from (f"witness: {name}: {sentence}" for name, sentence in data["witnesses"].items())
    yield from (f"note: {note}" for note in data["notes"])
    yield data["end"]
