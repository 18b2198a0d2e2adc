"""`scan registers` at work: the search of `register_map` asked of a device, with what silence and closing mean."""

import asyncio
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from drivers.errors import NO_WAY_TO_UNIT, DeviceException, DriverError, LinkDown, ReplyMismatch, ReplyTimeout
from drivers.survey import AsksRegisters
from gateway.commission.session import Site, Target, mention_gateway
from gateway.commission.survey.addresses import Register, parse_register
from gateway.commission.survey.register_map import ReadableMap, Stretch, search
from gateway.console import CommandResult, Progress

MOST_REGISTERS, MOST_BITS = 125, 2000
"""The protocol's own limits of one read (MODBUS Application Protocol V1.1b3, 6.1 to 6.4)."""
_BUSY = frozenset({5, 6})
ILLEGAL_FUNCTION = 1
_BUSY_TRIES = 8
_MAX_FIRST_SILENCES = 4
"""So many refusals by silence in a row, with no answer before them, are a device that is not there."""


@dataclass(slots=True)
class _Asking:
    """One device under search: the reasons of its refusals, and whether it has answered at all."""

    survey: AsksRegisters
    table: str
    reasons: Counter[str] = field(default_factory=Counter)
    alive: Stretch | None = None
    silences: int = 0

    async def answers(self, start: int, count: int) -> bool:
        """Whether the device answers a read of the block; silence and a closed connection are refusals, asked twice.

        Raises DeviceException for a table or a unit that is not there, ReplyTimeout or LinkDown for a device that is
        gone.
        """
        for last in (False, True):
            try:
                await self._ask_patiently(start, count)
            except DeviceException as error:
                if error.code in NO_WAY_TO_UNIT or error.code == ILLEGAL_FUNCTION:
                    raise
                self.reasons[f"exception {error.code}"] += 1
                return False
            except (ReplyTimeout, ReplyMismatch, LinkDown) as error:
                if last:
                    await self._find_alive(start, count)
                    await self._note_silence(error)
            else:
                self.alive, self.silences = (start, 1), 0
                return True
        return False

    async def _ask_patiently(self, start: int, count: int) -> None:
        """Ask, again after a pause while the device says that it is busy."""
        for attempt in range(_BUSY_TRIES):
            try:
                await self.survey.read(self.table, start, count)
            except DeviceException as error:
                if error.code not in _BUSY or attempt == _BUSY_TRIES - 1:
                    raise
                await asyncio.sleep(0.05 * 2**attempt)
            else:
                return

    async def _find_alive(self, start: int, count: int) -> None:
        """Of a device that has answered nothing yet: whether it answers one end of a block to which it is silent."""
        for place in (start, start + count - 1) if self.alive is None and count > 1 else ():
            with suppress(DriverError):
                await self.survey.read(self.table, place, 1)
                self.alive = (place, 1)
                return

    async def _note_silence(self, error: ReplyTimeout | ReplyMismatch | LinkDown) -> None:
        """A refusal by silence, if the device still answers elsewhere. Raises the error if it does not."""
        self.silences += 1
        if self.alive is None:
            if self.silences >= _MAX_FIRST_SILENCES or isinstance(error, LinkDown):
                raise error
        else:
            await self.survey.read(self.table, *self.alive)
        self.reasons["no reply" if isinstance(error, ReplyTimeout) else "no valid reply"] += 1


async def scan_registers(site: Site, first: Register, count: int, budget: int, progress: Progress) -> CommandResult:
    """What can be read of `count` addresses from `first` on, and the largest block, in at most `budget` requests.

    Blocks asked again after silence, and canaries that tell silence from absence, come on top of the budget.
    """
    mention_gateway(site)
    most = min(MOST_BITS if first.is_bit else MOST_REGISTERS, int(site.target.settings.get("max_registers", 2000)))
    async with site.registers() as survey:
        asking = _Asking(survey, first.table)
        steps = search(first.number, count, most=most, budget=budget)
        try:
            block = next(steps)
            while True:
                progress(f"{first.table}:{block[0]} count {block[1]}", (block[0] - first.number) / count)
                block = steps.send(await asking.answers(*block))
        except StopIteration as stop:  # a generator gives its result by this
            readable: ReadableMap = stop.value

    def ranges(stretches: Sequence[Stretch]) -> list[dict[str, Any]]:
        return [_range(Register(first.table, start), length) for start, length in stretches]

    data = {
        "table": first.table,
        "asked": _range(first, readable.count),
        "readable": ranges(readable.readable),
        "refused": ranges(readable.refusals),
        "unknown": ranges(readable.unknown),
        "largest_block": readable.largest,
        "too_long": readable.too_long or None,
        "seams": [f"{first.table}:{seam}" for seam in sorted(readable.seams)],
        "requests": readable.requests,
        "refusals": dict(asking.reasons),
    }
    if readable.unknown:
        left = sum(stretch[1] for stretch in readable.unknown)
        site.notes.append(f"{left} addresses were not asked: {budget} requests were the bound; give --requests")
    return CommandResult(data, "" if readable.readable else f"nothing of {first} count {count} can be read")


def _range(start: Register, count: int) -> dict[str, Any]:
    last = start.shift(count - 1)
    return {
        "first": str(start),
        "last": str(last),
        "reference": start.reference if count == 1 else f"{start.reference}-{last.reference}",
        "count": count,
    }


def first_register(target: Target) -> Register:
    """The address of the first tag, or holding:0 without a map."""
    return parse_register(target.tags[0].address) if target.tags else Register("holding", 0)
