"""`decanter plc write plan` and the tests that write: `loop alarms`, `loop heartbeat`, `conformance`."""

from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from gateway.commission.plc_arm import at
from gateway.commission.plc_audit_option import audit_option, audit_path, questions
from gateway.commission.plc_options import Given, link_options
from gateway.commission.plc_perform import perform
from gateway.console.lazy import LazyGroup, Table
from gateway.console.output import progress, table

if TYPE_CHECKING:
    from gateway.commission.outcome import Outcome, Site
    from gateway.commission.plc_side.by_hand import Hand

Progress = Callable[[str, float], None]

WRITES: Table = {
    "plan": ("gateway.commission.plc_write:plan", "What the gateway would write, word by word; nothing is sent."),
}
LOOPS: Table = {
    "alarms": ("gateway.commission.plc_write:alarms", "Each alarm bit through to the HMI, one after another."),
    "heartbeat": ("gateway.commission.plc_write:heartbeat", "Both heartbeats, and the PLC's timer."),
}
_ASK = click.option("--ask", is_flag=True, help="Put each question to the person at the HMI, here.")


@click.group(cls=LazyGroup, table=WRITES)
def write() -> None:
    """What would be written."""


@click.group(cls=LazyGroup, table=LOOPS)
def loop() -> None:
    """Loop tests of the write-back. They write, so they need an arming (decanter plc arm).

    Their blocks have validity 0, and the last one takes everything back; only the test of the PLC's timer needs a block
    that is valid, with a probability of 0 and no other number in it.
    """


@click.command()
@audit_option
@link_options
def plan(given: Given, audit: Path | None) -> None:
    """What the gateway would write, word by word, and by which rules; nothing is sent."""

    async def work(site: "Site") -> "Outcome":
        from gateway.commission.write_plan import plan as work

        return await work(site, audit_path(audit, given, site.target))

    perform(given, "write plan", {}, work, _show_plan)


def _show_plan(data: Mapping[str, Any]) -> None:
    columns = ("field", "address", "reference", "type", "scale", "unit", "unknown", "meaning")
    rows = [
        [word[column] if column != "scale" else f"{word['scale']:g}" for column in columns] for word in data["words"]
    ]
    table(f"the closed write map: {len(rows)} words, layout version {data['layout_version']}", columns, rows)
    bits = ", ".join(f"{one['bit']} {one['name']}" for one in data["alarm_bits"])
    click.echo(f"alarm bits: {bits}")
    period = f"a block a scan ({data['period_s']:g} s)" if data["period_s"] else "a block a scan"
    click.echo(f"one request a block, sent once; {period}, at most {data['most_per_second']:g} a second")
    click.echo(f"the PLC's timer: {data['plc_timer_s']:g} s; audit log {data['audit']}")
    armed = data["armed"]
    if armed:
        click.secho(f"ARMED until {at(armed['until'])} by {armed['by']}: {armed['reason']}", fg="yellow")
    else:
        click.echo(f"not armed{', mode ' + data['mode'] if data['mode'] else ''}")
    for problem in data["problems"]:
        click.secho(f"missing: {problem}", fg="red")


def _by_hand(
    given: Given,
    audit: Path | None,
    ask: bool,
    title: str,
    work: "Callable[[Hand, Progress], Awaitable[Outcome]]",
) -> "Callable[[Site], Awaitable[Outcome]]":
    """The work with a hand that may write, and a bar on a terminal where nobody is asked."""

    async def carried_out(site: "Site") -> "Outcome":
        from gateway.commission.plc_side.by_hand import hand

        async with hand(site, audit_path(audit, given, site.target), questions(ask)) as one:
            if ask:
                return await work(one, lambda _name, _share: None)
            with progress(title) as report:
                return await work(one, report)

    return carried_out


@click.command()
@_ASK
@audit_option
@link_options
def alarms(given: Given, ask: bool, audit: Path | None) -> None:
    """Set each alarm bit alone, then none: the PLC has to accept the block, and the HMI to show it (--ask)."""

    async def work(one: "Hand", report: Progress) -> "Outcome":
        from gateway.commission.plc_side.loop_tests import alarms as work

        return await work(one, report)

    perform(given, "loop alarms", {"ask": ask}, _by_hand(given, audit, ask, "loop alarms", work), _show_alarms)


def _show_alarms(data: Mapping[str, Any]) -> None:
    seen = {True: "yes", False: "NO", None: "not asked"}
    rows = [
        [_state(row), row["name"], "accepted" if row["accepted"] else "NOT ACCEPTED", seen[row["seen"]], row["meaning"]]
        for row in data["rows"]
    ]
    table("loop test of the alarm bits", ("", "bit", "the PLC", "seen at the HMI", "meaning"), rows)


@click.command()
@click.option("--watchdog/--no-watchdog", default=True, show_default=True, help="Let the PLC's timer run out too.")
@audit_option
@link_options
def heartbeat(given: Given, watchdog: bool, audit: Path | None) -> None:
    """Both heartbeats move and are checked; the PLC's timer runs out when the blocks cease."""

    async def work(one: "Hand", report: Progress) -> "Outcome":
        from gateway.commission.plc_side.loop_tests import heartbeat as work

        return await work(one, report, watchdog=watchdog)

    done = _by_hand(given, audit, False, "loop heartbeat", work)
    perform(given, "loop heartbeat", {"watchdog": watchdog}, done, _show_steps)


def _show_steps(data: Mapping[str, Any]) -> None:
    rows = [[_state(row), row["step"], row["sentence"]] for row in data["rows"]]
    table("loop test of the heartbeats", ("", "step", "seen"), rows)


@click.command()
@_ASK
@audit_option
@link_options
def conformance(given: Given, ask: bool, audit: Path | None) -> None:
    """Put the PLC's side of the write-back contract through the conformance suite, over the wire.

    It writes whole, torn, wrong and late blocks and asks the PLC what it makes of each; needs an arming. Takes about
    five times the PLC's timer. With --ask a person gives and takes the permit when the suite wants it.
    """

    async def work(one: "Hand", report: Progress) -> "Outcome":
        from gateway.commission.plc_side.suite import conform

        return await conform(one, report)

    done = _by_hand(given, audit, ask, "conformance", work)
    perform(given, "conformance", {"ask": ask}, done, _show_conformance)


def _show_conformance(data: Mapping[str, Any]) -> None:
    rows = [
        ["skipped" if row["skipped"] else _state(row), row["step"], row["wrong"] or row["skipped"]]
        for row in data["rows"]
    ]
    title = f"conformance: {data['passed']} of {data['steps']} steps passed, {data['skipped']} could not be put"
    table(title, ("", "step", "why"), rows)


def _state(row: Mapping[str, Any]) -> str:
    return "ok" if row["ok"] else "FAILED"
