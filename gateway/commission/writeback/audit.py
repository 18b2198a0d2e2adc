"""`decanter plc audit`: the account of every write, refusal and arming, and whether its chain is whole."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from gateway.commission.session import SharedOptions, at, audit_option, audit_path, record_options
from gateway.console import emit, table
from gateway.entry import Exit, fail, sentences
from gateway.store import read, verify


@click.command(short_help="Show and verify the audit log.")
@click.option("--head", default="", metavar="HASH", help="A hash kept from before, which has to be in the log.")
@click.option("--last", type=click.IntRange(0), default=20, show_default=True, help="So many of the newest rows.")
@click.option("--kind", "kinds", multiple=True, help="Only rows of this kind, such as 'armed' or 'write refused'.")
@click.option("--config", "plant", type=click.Path(path_type=Path), help="The plant file whose audit log it is.")
@audit_option
@record_options
def audit(given: SharedOptions, head: str, last: int, kinds: tuple[str, ...], audit: Path | None) -> None:
    """Show and verify the audit log: every write, refusal and arming, each row bound to the one before."""
    with sentences():
        path = audit_path(audit, given)
        checked = verify(path, head)
        rows = read(path, kinds)[-last:] if last and not checked.problem else []
    plain = [{"id": row.id, **asdict(row.entry), "hash": row.hash} for row in rows]
    result = {"ok": not checked.problem, "path": str(path), **asdict(checked), "entries": plain}
    emit(result, lambda: _show_audit(result), as_json_line=given.as_json)
    if checked.problem:
        fail(f"{path}: {checked.problem}", Exit.CHECK_FAILED)


def _show_audit(data: Mapping[str, Any]) -> None:
    title = f"{data['path']}: {data['rows']} rows, the chain is {'broken' if data['problem'] else 'whole'}"
    rows = [[entry["id"], at(entry["time"]), entry["kind"], entry["who"], entry["reason"]] for entry in data["entries"]]
    table(title, ("row", "time", "kind", "who", "reason"), rows)
    click.echo(f"head: {data['head']}")
