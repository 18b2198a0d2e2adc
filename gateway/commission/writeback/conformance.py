"""The conformance suite, put to a PLC over the wire."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from gateway.commission.session import CommandResult
from gateway.commission.writeback.block_writer import BlockWriter, block_column, joined
from gateway.commission.writeback.suite import Result, put_through, put_together
from gateway.commission.writeback.vectors import SuiteStep, together, vectors
from gateway.console import table


async def conform(
    writer: BlockWriter, progress: Callable[[str, float], None], steps: tuple[SuiteStep, ...] = ()
) -> CommandResult:
    """Every step's result; `steps` are those of the device file's layout unless given. Raises DriverError."""
    names = [field.name for field in writer.layout.fields]
    results = await put_through(steps or vectors(writer.layout), writer, writer.device.refusals, names, progress)
    return outcome(results)


async def conform_all(writers: Sequence[BlockWriter], progress: Callable[[str, float], None]) -> CommandResult:
    """Every block's own suite, and where there are several the steps for all of them together. Raises DriverError."""
    if len(writers) == 1:
        return await conform(writers[0], progress)
    results = [(writer.layout.temperature or "", await conform(writer, progress)) for writer in writers]
    return joined([*results, ("together", await conform_together(writers, progress))])


async def conform_together(writers: Sequence[BlockWriter], progress: Callable[[str, float], None]) -> CommandResult:
    """What is sent to one block never makes another one usable: the result of each step. Raises DriverError."""
    first = writers[0]
    names = [field.name for field in first.layout.fields]
    return outcome(await put_together(together(first.layout), writers, first.device.refusals, names, progress))


def outcome(results: Sequence[Result]) -> CommandResult:
    """The steps' results as a command's."""
    rows: list[dict[str, Any]] = [{**asdict(result), "ok": not result.wrong} for result in results]
    failed, skipped = [result for result in results if result.wrong], [result for result in results if result.skipped]
    counts = {"steps": len(rows), "passed": sum(result.passed for result in results), "skipped": len(skipped)}
    if failed:
        first = failed[0]
        return CommandResult(
            {**counts, "rows": rows}, 1, f"{len(failed)} steps failed, the first: {first.step}: {first.wrong}"
        )
    if not counts["passed"]:
        return CommandResult({**counts, "rows": rows}, 1, f"no step could be put: {skipped[0].skipped}")
    return CommandResult({**counts, "rows": rows})


def show_conformance(data: Mapping[str, Any]) -> None:
    """The result of `conform` for a person."""
    rows = [
        [
            "skipped" if row["skipped"] else "ok" if row["ok"] else "FAILED",
            *block,
            row["step"],
            row["wrong"] or row["skipped"],
        ]
        for row, block in zip(data["rows"], block_column(data), strict=True)
    ]
    title = f"conformance: {data['passed']} of {data['steps']} steps passed, {data['skipped']} could not be put"
    table(title, ("", *(["block"] if any(block_column(data)) else []), "step", "why"), rows)
