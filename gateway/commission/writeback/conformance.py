"""The conformance suite, put to a PLC over the wire."""

from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

from gateway.commission.session import CommandResult
from gateway.commission.writeback.block_writer import BlockWriter
from gateway.commission.writeback.suite import put_through
from gateway.commission.writeback.vectors import SuiteStep, vectors
from gateway.console import table


async def conform(
    writer: BlockWriter, progress: Callable[[str, float], None], steps: tuple[SuiteStep, ...] = ()
) -> CommandResult:
    """Every step's result; `steps` are those of the device file's layout unless given. Raises DriverError."""
    names = [field.name for field in writer.layout.fields]
    results = await put_through(steps or vectors(writer.layout), writer, writer.device.refusals, names, progress)
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
        ["skipped" if row["skipped"] else "ok" if row["ok"] else "FAILED", row["step"], row["wrong"] or row["skipped"]]
        for row in data["rows"]
    ]
    title = f"conformance: {data['passed']} of {data['steps']} steps passed, {data['skipped']} could not be put"
    table(title, ("", "step", "why"), rows)
