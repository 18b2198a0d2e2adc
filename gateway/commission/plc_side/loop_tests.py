"""Loop tests of the write-back: each alarm bit through to the HMI, heartbeats both ways, the PLC's timer."""

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from typing import Any

from drivers.errors import WriteUnverified
from gateway.commission.outcome import Outcome
from gateway.commission.plc_side.by_hand import NOTHING, SETTLE_S, Hand
from gateway.commission.plc_side.conformance import Account
from gateway.commission.plc_side.fields import ALARM_BITS, ALARM_MEANINGS
from gateway.commission.plc_side.structured_text import refusal_codes
from gateway.machine.writing.block import Validity

Progress = Callable[[str, float], None]
BLOCKS = 5
BEATS_SECONDS = 2.0
TIMER_TOLERANCE_S = 0.5
_STILL = "heartbeat did not change"
_USABLE = Validity(31)
_HARMLESS: dict[str, float | None] = {"input_quality": 0.0, "age": 0.0, "p_limit": 0.0, "zone": 1.0, "alarms": 0.0}


async def alarms(hand: Hand, progress: Progress) -> Outcome:
    """Set every alarm bit alone, then none; the PLC has to accept each block, and a person to see it at the HMI.

    The blocks have validity 0: nothing in them is to be used. Raises DriverError or ValueError.
    """
    if all(field.name != "alarms" for field in hand.layout.fields):
        raise ValueError(f"{hand.device.path}: the block has no field 'alarms'; there are no alarm bits to test")
    rows = []
    before = await hand.account()
    for bit, name in enumerate((*ALARM_BITS, "")):
        progress(name or "none", bit / (len(ALARM_BITS) + 1))
        await hand.block({**NOTHING, "alarms": float(1 << bit if name else 0)})
        after = await hand.account()
        row: dict[str, Any] = {
            "bit": bit if name else None,
            "name": name or "none",
            "meaning": ALARM_MEANINGS.get(name),
        }
        row |= {"accepted": _accepted(before, after, 1), "seen": _seen(hand, bit, name)}
        row["acknowledge_bits"] = await _acknowledged(hand)
        rows.append({**row, "ok": row["accepted"] and row["seen"] is not False})
        before = after
    return _outcome(rows, {"asked": hand.ask is not None}, "alarm bits")


def _seen(hand: Hand, bit: int, name: str) -> bool | None:
    """What the person sees at the HMI; None where nobody was asked."""
    if hand.ask is None:
        return None
    if not name:
        return hand.ask("Does the HMI show no alarm of the gateway now?")
    return hand.ask(f"Does the HMI show bit {bit}, {name} ({ALARM_MEANINGS[name]}), and no other?")


async def _acknowledged(hand: Hand) -> int | None:
    if "AcknowledgeBits" not in hand.device.by_name:
        return None
    return (await hand.numbers("AcknowledgeBits"))[0]


async def heartbeat(
    hand: Hand, progress: Progress, *, watchdog: bool = True, seconds: float = BEATS_SECONDS
) -> Outcome:
    """Both heartbeats (the PLC's watched for `seconds`) and, with `watchdog`, the PLC's timer.

    Raises DriverError or ValueError.
    """
    steps: list[Callable[[Hand], Awaitable[dict[str, Any]]]] = [partial(_plc_beats, seconds), _own_beats, _still]
    steps += [_timer] if watchdog else []
    rows = []
    for number, step in enumerate(steps):
        progress("heartbeats", number / len(steps))
        rows.append(await step(hand))
    return _outcome(rows, {"watchdog": watchdog}, "steps")


async def _plc_beats(seconds: float, hand: Hand) -> dict[str, Any]:
    """The PLC's heartbeat moves."""
    tag = hand.device.heartbeat
    if tag is None:
        return _row("the PLC's heartbeat moves", False, "the device file names no heartbeat")
    end, seen = time.monotonic() + seconds, 0
    last, since, longest = (await hand.numbers(tag))[0], time.monotonic(), 0.0
    while time.monotonic() < end:
        await asyncio.sleep(0.01)
        now = (await hand.numbers(tag))[0]
        if now != last:
            longest, since = max(longest, time.monotonic() - since), time.monotonic()
            last, seen = now, seen + 1
    said = f"{seen} changes in {seconds:g} s, the longest pause {longest:.2f} s" if seen else "it stands still"
    return _row("the PLC's heartbeat moves", seen > 0, said, changes=seen, longest_s=longest)


async def _own_beats(hand: Hand) -> dict[str, Any]:
    """Blocks with a new heartbeat are accepted."""
    before = await hand.account()
    for _ in range(BLOCKS):
        await hand.block()
        await hand.looked()
    after = await hand.account()
    ok = _accepted(before, after, BLOCKS)
    said = f"{after.accepted - before.accepted & 0xFFFF} of {BLOCKS} accepted"
    return _row("blocks with a new heartbeat are accepted", ok, said)


async def _still(hand: Hand) -> dict[str, Any]:
    """A block with the last heartbeat is refused."""
    before = await hand.account()
    with suppress(WriteUnverified):  # CANopen's acknowledge does not come for a refused block
        await hand.block(beat=False)
    after = await hand.account()
    code = refusal_codes(hand.device)[_STILL]
    refused = after.refused - before.refused & 0xFFFF == 1 and after.last_refusal == code
    said = f"refused {after.refused - before.refused & 0xFFFF}, last refusal {after.last_refusal} (wanted {code})"
    return _row("a block with the last heartbeat is refused", refused, said)


async def _timer(hand: Hand) -> dict[str, Any]:
    """The PLC's timer runs out when the blocks cease."""
    name, timeout = "the PLC's timer runs out when the blocks cease", hand.layout.timeout
    await hand.block(_HARMLESS, _USABLE)
    begun = time.monotonic()
    while not (await hand.numbers("PredictionUsable"))[0]:
        if time.monotonic() - begun > SETTLE_S:
            return _row(name, False, "the PLC does not hold a whole, valid block for usable")
        await asyncio.sleep(0.02)
    while (await hand.numbers("PredictionUsable"))[0]:
        if time.monotonic() - begun > 2 * timeout + TIMER_TOLERANCE_S:
            return _row(
                name, False, f"it still runs after {time.monotonic() - begun:.1f} s; it should after {timeout:g} s"
            )
        await asyncio.sleep(0.02)
    spent = time.monotonic() - begun
    ok = abs(spent - timeout) <= max(TIMER_TOLERANCE_S, 0.1 * timeout)
    return _row(name, ok, f"after {spent:.2f} s; the device file says {timeout:g} s", seconds=spent)


def _row(name: str, ok: bool, said: str, **more: Any) -> dict[str, Any]:
    return {"step": name, "ok": ok, "sentence": said, **more}


def _accepted(before: Account, after: Account, blocks: int) -> bool:
    return after.accepted - before.accepted & 0xFFFF == blocks and after.refused == before.refused


def _outcome(rows: list[dict[str, Any]], more: dict[str, Any], what: str) -> Outcome:
    failed = [row for row in rows if not row["ok"]]
    first = (failed[0].get("step") or failed[0].get("name")) if failed else ""
    complaint = f"{len(failed)} of {len(rows)} {what} failed, {first!r} the first" if failed else ""
    return Outcome({"rows": rows, **more}, int(bool(failed)), complaint)
