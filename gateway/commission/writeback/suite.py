"""Putting a PLC's side of the write-back contract through the conformance suite, step by step."""

from collections.abc import AsyncGenerator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from gateway.commission.writeback.vectors import SuiteStep
from gateway.console import Progress
from gateway.machine.writing import crc


@dataclass(frozen=True, slots=True)
class Account:
    """What the PLC says of the blocks: its wrapping 16-bit counters, the last refusal's number, its own verdict.

    And its session: the challenge, whose blocks count (0: nobody's), the writer that was refused last (0: none).
    """

    accepted: int
    refused: int
    last_refusal: int
    usable: bool
    challenge: int
    session_writer: int
    refused_writer: int


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


async def run_suite(
    steps: Sequence[SuiteStep],
    side: PlcSide,
    codes: Mapping[str, int],
    names: Sequence[str],
    progress: Progress = lambda _name, _share: None,
) -> list[Result]:
    """The result of every step; `names` are the block's fields. Raises DriverError where the PLC cannot be reached."""
    return await run_steps(steps, [side], codes, names, progress)


async def run_steps(
    steps: Sequence[SuiteStep],
    sides: Sequence[PlcSide],
    codes: Mapping[str, int],
    names: Sequence[str],
    progress: Progress = lambda _name, _share: None,
) -> list[Result]:
    """As `run_suite`, with one PLC's several blocks: each step is put to its `block`, and all of them are watched."""
    return [result async for result in each_result(steps, sides, codes, names, progress)]


async def each_result(
    steps: Sequence[SuiteStep],
    sides: Sequence[PlcSide],
    codes: Mapping[str, int],
    names: Sequence[str],
    progress: Progress = lambda _name, _share: None,
) -> AsyncGenerator[Result, None]:
    """The results of `run_steps`, each as soon as its step is done."""
    sent: dict[str, tuple[int, ...]] = {}
    before = [await side.account() for side in sides]
    for number, step in enumerate(steps):
        progress(step.name, number / len(steps))
        side = sides[step.block]
        try:
            # The permit before the pause, the pause before the block: the PLC's timer runs while nothing is written.
            if step.permit is not None:
                await side.permit(step.permit)
            if step.wait_s:
                await side.wait(step.wait_s)
            if step.again and step.again not in sent:
                raise Unable(f"the block of {step.again!r} was not sent")
            words = sent[step.again] if step.again else step.words
            if step.challenge is not None:
                # After the pause, in which the session may have ended.
                words = in_session(step, names, (await side.account()).challenge)
            if words:
                sent[step.name] = words
                await side.write(step.offset, words)
            after = [await each.account() for each in sides]
        except Unable as reason:
            yield Result(step.name, skipped=str(reason))
            before = [await each.account() for each in sides]
            continue
        wrong = [judge(step, before[step.block], after[step.block], codes)]
        wrong += [
            find_spill(before[other], after[other], after[step.block])
            for other in range(len(sides))
            if other != step.block
        ]
        yield Result(step.name, "; ".join(filter(None, wrong)))
        before = after


def find_spill(before: Account, after: Account, own: Account) -> str:
    """What a step has wrongly done to a block that it was not put to, in words; `own` is its own block's account."""
    faults = []
    if (after.accepted, after.refused) != (before.accepted, before.refused):
        faults.append("another block counts it too")
    if after.usable and not before.usable:
        faults.append("another block has become usable by it")
    if after.challenge == own.challenge:
        faults.append(f"two blocks have the challenge {own.challenge}")
    return "; ".join(faults)


def in_session(step: SuiteStep, names: Sequence[str], challenge: int) -> tuple[int, ...]:
    """The step's block with the PLC's challenge, bent as the step wants it, and with its checksum."""
    words, seal = list(step.words), names.index("crc")
    words[names.index("challenge")] = challenge ^ (step.challenge or 0)
    words[seal] = crc(words[:seal])
    if step.turned is not None:
        place, bits = step.turned
        words[place] ^= bits
    return tuple(words)


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
    if step.renews is not None and (after.challenge != before.challenge) != step.renews:
        wrong = "is another one, and the session has not ended"
        faults.append(f"the challenge {'is the same, and the session has ended' if step.renews else wrong}")
    for name, number, now in (
        ("session", step.session_writer, after.session_writer),
        ("refused", step.refused_writer, after.refused_writer),
    ):
        if number is not None and now != number:
            faults.append(f"the {name} writer is {now} instead of {number}")
    return "; ".join(faults)
