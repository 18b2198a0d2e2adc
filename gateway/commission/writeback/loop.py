"""Loop tests of the write-back: alarm bits to the HMI, heartbeats both ways, the PLC's timer."""

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

from drivers.errors import WriteUnverified
from gateway.commission.writeback.block_writer import NOTHING, SETTLE_S, BlockWriter, rows_of_test
from gateway.commission.writeback.fields import ALARM_BITS, ALARM_MEANINGS
from gateway.commission.writeback.suite import Account
from gateway.console import CommandResult, Progress, Rows
from gateway.machine.writing import Validity

BLOCKS = 5
BEATS_SECONDS = 2.0
TIMER_TOLERANCE_S = 0.5
_STILL = "heartbeat did not change"
_USABLE = Validity(31)
_KEPT = Validity.INPUTS  # nothing of it is usable, and unlike validity 0 it ends no session
_HARMLESS: dict[str, float | None] = {"input_quality": 0.0, "age": 0.0, "p_limit": 0.0, "zone": 1.0, "alarms": 0.0}


async def alarm_loop(writer: BlockWriter, progress: Progress) -> CommandResult:
    """Set every alarm bit alone, then none; the PLC has to accept each block, and a person to see it at the HMI.

    The blocks have validity 0: nothing in them is to be used. Raises DriverError or ValueError.
    """
    if all(field.name != "alarms" for field in writer.layout.fields):
        raise ValueError(f"{writer.device.path}: the block has no field 'alarms'; there are no alarm bits to test")
    rows = []
    of = f" of {writer.layout.temperature}" if writer.layout.blocks > 1 else ""
    before = await writer.account()
    for bit, name in enumerate((*ALARM_BITS, "")):
        progress(name or "none", bit / (len(ALARM_BITS) + 1))
        await writer.block({**NOTHING, "alarms": float(1 << bit if name else 0)})
        after = await writer.account()
        row: dict[str, Any] = {
            "bit": bit if name else None,
            "name": name or "none",
            "meaning": ALARM_MEANINGS.get(name),
        }
        seen: bool | None = None  # nobody was asked
        if writer.ask is not None and name:
            seen = writer.ask(f"Does the HMI show bit {bit}{of}, {name} ({ALARM_MEANINGS[name]}), and no other?")
        elif writer.ask is not None:
            seen = writer.ask(f"Does the HMI show no alarm{of} of the gateway now?")
        row |= {"accepted": _took_all(before, after, 1), "seen": seen}
        # After the question: what the person acknowledged at the HMI meanwhile shows in it.
        word = writer.layout.acknowledge_bits
        row["acknowledge_bits"] = (await writer.numbers(word))[0] if word in writer.device.by_name else None
        rows.append({**row, "ok": row["accepted"] and row["seen"] is not False})
        before = after
    return _outcome(rows, {"asked": writer.ask is not None}, "alarm bits")


async def heartbeat_loop(
    writer: BlockWriter, progress: Progress, *, watchdog: bool = True, seconds: float = BEATS_SECONDS
) -> CommandResult:
    """Both heartbeats (the PLC's watched for `seconds`) and, with `watchdog`, the PLC's timer.

    Raises DriverError or ValueError.
    """
    steps: list[Callable[[BlockWriter], Awaitable[dict[str, Any]]]] = [partial(_plc_beats, seconds), _own_beats, _still]
    steps += [_timer] if watchdog else []
    rows = []
    for number, step in enumerate(steps):
        progress("heartbeats", number / len(steps))
        rows.append(await step(writer))
    return _outcome(rows, {"watchdog": watchdog}, "steps")


async def _plc_beats(seconds: float, writer: BlockWriter) -> dict[str, Any]:
    """The PLC's heartbeat moves."""
    tag = writer.device.heartbeat
    if tag is None:
        return _row("the PLC's heartbeat moves", False, "the device file names no heartbeat")
    end, seen = time.monotonic() + seconds, 0
    last, since, longest = (await writer.numbers(tag))[0], time.monotonic(), 0.0
    while time.monotonic() < end:
        await asyncio.sleep(0.01)
        now = (await writer.numbers(tag))[0]
        if now != last:
            longest, since = max(longest, time.monotonic() - since), time.monotonic()
            last, seen = now, seen + 1
    sentence = f"{seen} changes in {seconds:g} s, the longest pause {longest:.2f} s" if seen else "it stands still"
    return _row("the PLC's heartbeat moves", seen > 0, sentence, changes=seen, longest_s=longest)


async def _own_beats(writer: BlockWriter) -> dict[str, Any]:
    """Blocks with a new heartbeat are accepted."""
    before = await writer.account()
    for _ in range(BLOCKS):
        await writer.block(validity=_KEPT)
        await writer.wait_for_scans()
    after = await writer.account()
    ok = _took_all(before, after, BLOCKS)
    sentence = f"{after.accepted - before.accepted & 0xFFFF} of {BLOCKS} accepted"
    return _row("blocks with a new heartbeat are accepted", ok, sentence)


async def _still(writer: BlockWriter) -> dict[str, Any]:
    """A block with the last heartbeat is refused."""
    before = await writer.account()
    with suppress(WriteUnverified):  # CANopen's acknowledge does not come for a refused block
        await writer.block(validity=_KEPT, beat=False)
    after = await writer.account()
    code = writer.device.refusals[_STILL]
    refused = after.refused - before.refused & 0xFFFF == 1 and after.last_refusal == code
    sentence = f"refused {after.refused - before.refused & 0xFFFF}, last refusal {after.last_refusal} (wanted {code})"
    return _row("a block with the last heartbeat is refused", refused, sentence)


async def _timer(writer: BlockWriter) -> dict[str, Any]:
    """The PLC's timer runs out when the blocks cease."""
    name, timeout = "the PLC's timer runs out when the blocks cease", writer.layout.timeout
    usable = writer.layout.tag("PredictionUsable")
    await writer.block(_HARMLESS, _USABLE)
    # Timed from the block: the wait until the PLC holds it for usable is part of what its timer has counted.
    begun = time.monotonic()
    while not (await writer.numbers(usable))[0]:
        if time.monotonic() - begun > SETTLE_S:
            return _row(name, False, "the PLC does not hold a whole, valid block for usable")
        await asyncio.sleep(0.02)
    while (await writer.numbers(usable))[0]:
        if time.monotonic() - begun > 2 * timeout + TIMER_TOLERANCE_S:
            return _row(
                name, False, f"it still runs after {time.monotonic() - begun:.1f} s; it should after {timeout:g} s"
            )
        await asyncio.sleep(0.02)
    spent = time.monotonic() - begun
    ok = abs(spent - timeout) <= max(TIMER_TOLERANCE_S, 0.1 * timeout)
    return _row(name, ok, f"after {spent:.2f} s; the device file says {timeout:g} s", seconds=spent)


def _row(name: str, ok: bool, sentence: str, **more: Any) -> dict[str, Any]:
    return {"step": name, "ok": ok, "sentence": sentence, **more}


def _took_all(before: Account, after: Account, blocks: int) -> bool:
    # The PLC's counters are words that begin anew at 65536: differences are taken modulo that.
    return after.accepted - before.accepted & 0xFFFF == blocks and after.refused == before.refused


def _outcome(rows: list[dict[str, Any]], more: dict[str, Any], what: str) -> CommandResult:
    failed = [row for row in rows if not row["ok"]]
    first = (failed[0].get("step") or failed[0].get("name")) if failed else ""
    complaint = f"{len(failed)} of {len(rows)} {what} failed, {first!r} the first" if failed else ""
    return CommandResult({"rows": rows, **more}, complaint)


def view_alarms(data: Mapping[str, Any]) -> Iterator[Rows]:
    """The result of `alarm_loop` for a person."""
    seen = {True: "yes", False: "NO", None: "not asked"}

    def cells(row: Mapping[str, Any]) -> dict[str, Any]:
        accepted = "accepted" if row["accepted"] else "NOT ACCEPTED"
        return {
            "bit": row["name"],
            "the PLC": accepted,
            "seen at the HMI": seen[row["seen"]],
            "meaning": row["meaning"],
        }

    yield rows_of_test("loop test of the alarm bits", data, cells)


def view_heartbeats(data: Mapping[str, Any]) -> Iterator[Rows]:
    """The result of `heartbeat_loop` for a person."""
    yield rows_of_test("loop test of the heartbeats", data, lambda row: {"step": row["step"], "seen": row["sentence"]})
