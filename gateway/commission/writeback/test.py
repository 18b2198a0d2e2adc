"""`decanter plc check write`: what is written on purpose to see that the PLC's side of the write-back works."""

from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import click

from gateway.commission.options import SharedOptions
from gateway.commission.session import perform
from gateway.commission.writeback.block_writer import (
    BlockWriter,
    join_results,
    of_each_block,
    rows_of_test,
    with_block_writers,
)
from gateway.commission.writeback.loop import alarm_loop, heartbeat_loop, view_alarms, view_heartbeats
from gateway.commission.writeback.suite import Result, run_steps, run_suite
from gateway.commission.writeback.vectors import SuiteStep, joint_steps, vectors
from gateway.console import CommandResult, Progress, Rows, View


async def conform(writer: BlockWriter, progress: Progress, steps: tuple[SuiteStep, ...] = ()) -> CommandResult:
    """Every step's result; `steps` are those of the device file's layout unless given. Raises DriverError."""
    names = [field.name for field in writer.layout.fields]
    results = await run_suite(steps or vectors(writer.layout), writer, writer.device.refusals, names, progress)
    return outcome(results)


async def conform_all(writers: Sequence[BlockWriter], progress: Progress) -> CommandResult:
    """Every block's own suite, and where there are several the steps for all of them together. Raises DriverError."""
    if len(writers) == 1:
        return await conform(writers[0], progress)
    results = [(writer.layout.temperature or "", await conform(writer, progress)) for writer in writers]
    return join_results([*results, ("together", await conform_jointly(writers, progress))])


async def conform_jointly(writers: Sequence[BlockWriter], progress: Progress) -> CommandResult:
    """What is sent to one block never makes another one usable: the result of each step. Raises DriverError."""
    first = writers[0]
    names = [field.name for field in first.layout.fields]
    return outcome(await run_steps(joint_steps(first.layout), writers, first.device.refusals, names, progress))


def outcome(results: Sequence[Result]) -> CommandResult:
    """The steps' results as a command's."""
    rows: list[dict[str, Any]] = [{**asdict(result), "ok": not result.wrong} for result in results]
    wrong, skipped = [result for result in results if result.wrong], [result for result in results if result.skipped]
    passed, complaint = sum(result.passed for result in results), ""
    if wrong:
        complaint = f"{len(wrong)} steps failed, the first: {wrong[0].step}: {wrong[0].wrong}"
    elif not passed:
        complaint = f"no step could be put: {skipped[0].skipped}"
    return CommandResult({"steps": len(rows), "passed": passed, "skipped": len(skipped), "rows": rows}, complaint)


def view_conformance(data: Mapping[str, Any]) -> Iterator[Rows]:
    """The result of `conform` for a person."""
    title = f"conformance: {data['passed']} of {data['steps']} steps passed, {data['skipped']} could not be put"
    yield rows_of_test(title, data, lambda row: {"step": row["step"], "why": row["wrong"] or row["skipped"]})


Test = Callable[[Sequence[BlockWriter], Progress], Awaitable[CommandResult]]
TESTS: dict[str, tuple[Test, View, tuple[str, ...]]] = {
    "alarms": (of_each_block(alarm_loop), view_alarms, ("ask",)),
    "heartbeat": (of_each_block(heartbeat_loop), view_heartbeats, ("watchdog",)),
    "conformance": (conform_all, view_conformance, ("ask",)),
}
"""What can be tested -> the test, what is seen of its result, and which of the command's options it takes."""


def test(given: SharedOptions, what: str, audit: Path | None, **options: bool | None) -> None:
    """The work of `plc check write`."""
    work, view, taken = TESTS[what]
    for name, value in options.items():
        if value is not None and name not in taken:
            others = " and ".join(other for other, (_, _, names) in TESTS.items() if name in names)
            raise click.UsageError(f"--{name} is for {others}, not for {what}")
    ask, watchdog = bool(options["ask"]), options["watchdog"] is not False
    arguments = {"ask": ask} if "ask" in taken else {"watchdog": watchdog}
    if what == "heartbeat":
        work = of_each_block(partial(heartbeat_loop, watchdog=watchdog))
    perform(given, f"test {what}", arguments, with_block_writers(given, audit, f"test {what}", work, ask=ask), view)
