"""`decanter plc report`: the site acceptance report, made from the commands' own records, and its verification."""

import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from drivers.named_files import regular
from gateway.commission.acceptance import gather, verify, write
from gateway.commission.session import SharedOptions, audit_option, audit_path, login, record_options
from gateway.console import emit, table
from gateway.entry import Exit, fail, sentences
from gateway.machine.writing import places_for
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
        _verify(out, seal, as_json=given.as_json)
        return
    with sentences():
        now, by, log_path = time.time(), given.by or login(), audit_path(audit, given)
        records = regular(given.records).read_bytes()
        config = load_plant(given.plant)[0] if given.plant is not None else None
        data = gather(given.records, places_for(log_path, config), site=site, by=by, now=now, remarks=remarks)
        data["site"] = site or "; ".join(data["places"]) or "no device"
        own_seal = write(out, data, records)
        # The seal stands apart from the report too: whoever makes all of it anew makes another seal.
        if log_path.exists():
            log = open_audit(log_path)
            detail = {"seal": own_seal, "folder": str(out)}
            stored = log.record(AuditEntry(now, "acceptance report", by, data["verdict"], detail))
            log.close()
            if not stored:
                raise ValueError(f"the report is made, but its seal is not in the audit log: {log.failure}")
    result = {
        "verdict": data["verdict"],
        "checks": {check["command"]: check["state"] for check in data["checks"]},
        "open_points": data["open_points"],
        "out": str(out),
        "seal": own_seal,
    }
    emit({"ok": result["verdict"] != "failed", **result}, lambda: _show(result), as_json_line=given.as_json)
    if result["verdict"] == "failed":
        fail(f"the site is not accepted: {result['open_points'][0]}", Exit.CHECK_FAILED)


def _show(result: Mapping[str, Any]) -> None:
    table("site acceptance test", ("check", "result"), [[name, state] for name, state in result["checks"].items()])
    colour = {"passed": "green", "failed": "red"}.get(result["verdict"], "yellow")
    click.secho(f"result: {result['verdict']}", fg=colour)
    for number, point in enumerate(result["open_points"], start=1):
        click.echo(f"open {number}: {point}")
    click.echo(f"report: {result['out']}/report.html, report.pdf, report.json")
    click.echo(f"seal: {result['seal']}")


def _verify(folder: Path, seal: str, *, as_json: bool) -> None:
    with sentences():
        actual, rows = verify(folder, seal)
    bad = [row for row in rows if not row["ok"]]
    data = {"ok": not bad, "folder": str(folder), "seal": actual, "files": rows}

    def show() -> None:
        states = [[row["file"], "as it was made" if row["ok"] else row["problem"]] for row in rows]
        table(f"report in {folder}", ("file", ""), states)
        click.echo(f"seal: {actual}")

    emit(data, show, as_json_line=as_json)
    if bad:
        fail(f"{folder / bad[0]['file']}: {bad[0]['problem']}", Exit.CHECK_FAILED)
