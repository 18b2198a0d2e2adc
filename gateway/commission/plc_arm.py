"""`decanter plc arm`, `disarm` and `audit`: who lets blocks be written, and the account of all that was."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commission.plc_audit_option import audit_option, audit_path
from gateway.commission.plc_options import Given, link_options, record_options
from gateway.commission.plc_perform import perform
from gateway.console.output import Exit, table

if TYPE_CHECKING:
    from gateway.commission.outcome import Outcome, Site


@click.command()
@click.option("--reason", required=True, help="Why blocks are to be written, for the audit log.")
@click.option("--minutes", type=float, required=True, help="For how long, 480 at most; then it ends by itself.")
@audit_option
@link_options
def arm(given: Given, reason: str, minutes: float, audit: Path | None) -> None:
    """Let blocks be written for some minutes: by the loop tests, and by a gateway with mode 'shadow'.

    A gateway that runs is told so; one that starts meanwhile finds it in the audit log. Needs a name (--by).
    """

    async def work(site: "Site") -> "Outcome":
        from gateway.commission.arm import arm as work

        return await work(site, audit_path(audit, given, site.target), given.by, reason, minutes)

    perform(given, "arm", {"reason": reason, "minutes": minutes}, work, _show_armed)


def _show_armed(data: Mapping[str, Any]) -> None:
    click.secho(f"ARMED until {at(data['until'])} by {data['by']}: {data['reason']}", fg="yellow")
    click.echo(f"told to {data['told']}; audit log {data['audit']}, head {data['head'][:16]}")


@click.command()
@click.option("--reason", default="by command", show_default=True, help="Why, for the audit log.")
@audit_option
@link_options
def disarm(given: Given, reason: str, audit: Path | None) -> None:
    """Take the arming back: at once, with a block of validity 0 if one can be written."""

    async def work(site: "Site") -> "Outcome":
        from gateway.commission.arm import disarm as work
        from gateway.commission.plc_perform import login

        return await work(site, audit_path(audit, given, site.target), given.by or login(), reason)

    perform(given, "disarm", {"reason": reason}, work, _show_disarmed)


def _show_disarmed(data: Mapping[str, Any]) -> None:
    said = f"disarmed; {data['said']}" if data["was_armed"] else "nothing was armed"
    click.echo(f"{said}; audit log {data['audit']}, head {data['head'][:16]}")


@click.command()
@click.option("--head", default="", metavar="HASH", help="A hash kept from before, which has to be in the log.")
@click.option("--last", type=click.IntRange(0), default=20, show_default=True, help="So many of the newest rows.")
@click.option("--kind", "kinds", multiple=True, help="Only rows of this kind, such as 'armed' or 'write refused'.")
@click.option("--config", "plant", type=click.Path(path_type=Path), help="The plant file whose audit log it is.")
@audit_option
@record_options
def audit(given: Given, head: str, last: int, kinds: tuple[str, ...], audit: Path | None) -> None:
    """Show and verify the audit log: every write, refusal and arming, each row bound to the one before."""
    from dataclasses import asdict

    from gateway.console.output import emit, fail, sentences

    with sentences():
        from gateway.store.audit import read, verify

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
    rows = [[one["id"], at(one["time"]), one["kind"], one["who"], one["reason"]] for one in data["entries"]]
    table(title, ("row", "time", "kind", "who", "reason"), rows)
    click.echo(f"head: {data['head']}")


def at(moment: float) -> str:
    """A moment (s UTC) for a person."""
    return datetime.fromtimestamp(moment, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
