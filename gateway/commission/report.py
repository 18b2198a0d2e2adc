"""`decanter plc report`: the site acceptance report, made from the commands' own records, and its verification."""

import time
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

import click

from drivers.named_files import regular
from gateway.commission.acceptance import gather, verify, write
from gateway.commission.options import SharedOptions, audit_option, record_options
from gateway.commission.session import audit_path, login
from gateway.console import CommandResult, Line, Part, Rows, conclude
from gateway.entry import sentences
from gateway.machine.writing import find_places
from gateway.settings import load_plant
from gateway.store import AuditEntry, open_audit


@click.command(short_help="Make or verify the site acceptance report: page, paper, JSON.")
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("out/acceptance"),
    show_default=True,
    help="Folder of the report.",
)
@click.option("--site", default="", help="Name of the plant.  [default: where the device is]")
@click.option("--remark", "remarks", multiple=True, help="An open point of your own; may be given several times.")
@click.option(
    "--config",
    "plant",
    type=click.Path(path_type=Path),
    help="The plant file whose audit log it is.  [default: plant.toml, config/plant.toml]",
)
@click.option("--verify", "verifies", is_flag=True, help="Check the files of a report instead of making one.")
@click.option("--seal", default="", metavar="HASH", help="With --verify: the seal that was signed.")
@audit_option
@record_options
def report(
    given: SharedOptions,
    out: Path,
    site: str,
    remarks: tuple[str, ...],
    verifies: bool,
    seal: str,
    audit: Path | None,
) -> None:
    """Make the site acceptance report: page, paper and JSON, hashed and sealed; --verify finds a changed byte.

    It holds every check with the hash of its raw frames, the configuration's hashes, versions, the clock's offset,
    names and what is open. Exit code 1 if a check failed or something is changed.
    """
    if verifies:
        with sentences():
            verified = _check_files(out, seal)
        conclude(verified, _view_of_files, as_json=given.as_json)
        return
    with sentences():
        now, by, log_path = time.time(), given.by or login(), audit_path(audit, given)
        records = regular(given.records).read_bytes()
        config = load_plant(given.plant)[0] if given.plant is not None else None
        data = gather(given.records, find_places(log_path, config), site=site, by=by, now=now, remarks=remarks)
        data["site"] = site or "; ".join(data["places"]) or "no device"
        own_seal = write(out, data, records)
        # The seal stands apart from the report too: whoever makes all of it anew makes another seal.
        if log_path.exists():
            detail = {"seal": own_seal, "folder": str(out)}
            with closing(open_audit(log_path)) as log:
                stored = log.record(AuditEntry(now, "acceptance report", by, data["verdict"], detail))
            if not stored:
                raise ValueError(f"the report is made, but its seal is not in the audit log: {log.failure}")
    result = {
        "verdict": data["verdict"],
        "checks": {check["command"]: check["state"] for check in data["checks"]},
        "open_points": data["open_points"],
        "out": str(out),
        "seal": own_seal,
    }
    complaint = f"the site is not accepted: {data['open_points'][0]}" if data["verdict"] == "failed" else ""
    conclude(CommandResult(result, complaint), _view, as_json=given.as_json)


def _view(result: Mapping[str, Any]) -> Iterator[Part]:
    yield Rows("site acceptance test", ("check", "result"), [*result["checks"].items()])
    colour = {"passed": "green", "failed": "red"}.get(result["verdict"], "yellow")
    yield Line(f"result: {result['verdict']}", colour)
    yield from (f"open {number}: {point}" for number, point in enumerate(result["open_points"], start=1))
    yield f"report: {result['out']}/report.html, report.pdf, report.json"
    yield f"seal: {result['seal']}"


def _check_files(folder: Path, seal: str) -> CommandResult:
    actual, rows = verify(folder, seal)
    bad = next((row for row in rows if not row.ok), None)
    complaint = f"{folder / bad.file}: {bad.problem}" if bad else ""
    files = [{"file": row.file, "ok": row.ok, "problem": row.problem} for row in rows]
    return CommandResult({"folder": str(folder), "seal": actual, "files": files}, complaint)


def _view_of_files(data: Mapping[str, Any]) -> Iterator[Part]:
    states = [(row["file"], "as it was made" if row["ok"] else row["problem"]) for row in data["files"]]
    yield Rows(f"report in {data['folder']}", ("file", ""), states)
    yield f"seal: {data['seal']}"
