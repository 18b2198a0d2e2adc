"""The conformance suite put to a PLC over the wire."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from gateway.commission.outcome import Outcome
from gateway.commission.plc_side.by_hand import Hand
from gateway.commission.plc_side.conformance import put_through
from gateway.commission.plc_side.structured_text import refusal_codes
from gateway.commission.plc_side.vectors import Step, vectors


async def conform(hand: Hand, progress: Callable[[str, float], None], steps: tuple[Step, ...] = ()) -> Outcome:
    """Every step's result; `steps` are those of the device file's layout unless given. Raises DriverError."""
    results = await put_through(steps or vectors(hand.layout), hand, refusal_codes(hand.device), progress)
    rows: list[dict[str, Any]] = [{**asdict(one), "ok": not one.wrong} for one in results]
    failed, skipped = [one for one in results if one.wrong], [one for one in results if one.skipped]
    counts = {"steps": len(rows), "passed": sum(one.passed for one in results), "skipped": len(skipped)}
    if failed:
        first = failed[0]
        return Outcome(
            {**counts, "rows": rows}, 1, f"{len(failed)} steps failed, the first: {first.step}: {first.wrong}"
        )
    if not counts["passed"]:
        return Outcome({**counts, "rows": rows}, 1, f"no step could be put: {skipped[0].skipped}")
    return Outcome({**counts, "rows": rows})
