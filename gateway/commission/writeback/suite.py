"""Putting a PLC's side of the write-back contract through the conformance suite, step by step."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from gateway.commission.writeback.vectors import SuiteStep


@dataclass(frozen=True, slots=True)
class Account:
    """What the PLC says of the blocks: its wrapping 16-bit counters, the last refusal's number, its own verdict."""

    accepted: int
    refused: int
    last_refusal: int
    usable: bool


@dataclass(frozen=True, slots=True)
class Result:
    """One step: `skipped` says why it could not be put, else `wrong` what was not as it must be ("" if all was)."""

    step: str
    wrong: str = ""
    skipped: str = ""

    @property
    def passed(self) -> bool:
        """True if the step was put and all was as it must be."""
        return not self.wrong and not self.skipped


class PlcSide(Protocol):
    """A PLC that is put through the suite. A step that it cannot be put is refused by raising Unable."""

    async def permit(self, on: bool) -> None:
        """Give or take the permit at the PLC."""
        ...

    async def write(self, offset: int, words: Sequence[int]) -> None:
        """Write words into the block's area from `offset` on, as one write."""
        ...

    async def wait(self, seconds: float) -> None:
        """Let so much time pass."""
        ...

    async def account(self) -> Account:
        """What the PLC says, once its program has looked at all that was written before."""
        ...


class Unable(Exception):
    """This step cannot be put to this PLC, or not over this link; the message says why."""


async def put_through(
    steps: Sequence[SuiteStep],
    side: PlcSide,
    codes: Mapping[str, int],
    progress: Callable[[str, float], None] = lambda _name, _share: None,
) -> list[Result]:
    """The result of every step. Raises DriverError where the PLC cannot be reached."""
    results: list[Result] = []
    before = await side.account()
    for number, step in enumerate(steps):
        progress(step.name, number / len(steps))
        try:
            # The permit before the pause, the pause before the block: the PLC's timer runs while nothing is written.
            if step.permit is not None:
                await side.permit(step.permit)
            if step.wait_s:
                await side.wait(step.wait_s)
            if step.words:
                await side.write(step.offset, step.words)
            after = await side.account()
        except Unable as reason:
            results.append(Result(step.name, skipped=str(reason)))
            before = await side.account()
            continue
        results.append(Result(step.name, judge(step, before, after, codes)))
        before = after
    return results


def judge(step: SuiteStep, before: Account, after: Account, codes: Mapping[str, int]) -> str:
    """What the PLC has made wrong of a step, in words; "" if nothing."""
    faults = []
    for name, expected, old, new in (
        ("accepted", step.accepted, before.accepted, after.accepted),
        ("refused", step.refused, before.refused, after.refused),
    ):
        if (new - old) & 0xFFFF != expected:
            faults.append(f"{(new - old) & 0xFFFF} blocks {name} instead of {expected}")
    allowed = {codes[reason] for reason in step.reasons}
    if step.refused and after.last_refusal not in allowed:
        faults.append(f"refusal {after.last_refusal} instead of {' or '.join(map(str, sorted(allowed)))}")
    if after.usable != step.usable:
        faults.append(f"the prediction is {'usable' if after.usable else 'not usable'}, which it must not be")
    return "; ".join(faults)
