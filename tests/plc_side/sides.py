"""The PLCs that the conformance suite is put to: the emulator's program, and the generated Structured Text."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Protocol

from drivers.device_file import STATUS_TAGS
from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.suite import Account, in_session
from gateway.commission.writeback.vectors import SuiteStep
from gateway.settings.devices import BLOCK_FIELDS, load_device
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from tests.plc_side.structured_text import Instance, Text

CYCLE_MS = 20
LONG_CYCLE = 10
"""Cycles that one of the interpreter's lasts at most while a test only waits."""


def present(words: Sequence[int], challenge: int) -> tuple[int, ...]:
    """A block of the shipped layout with the PLC's challenge of now, and with the checksum that fits."""
    return in_session(SuiteStep("", tuple(words), challenge=0), BLOCK_FIELDS, challenge)


parsed = cache(Text)
"""A text is parsed once: what runs of it is an instance."""


class Emulated:
    """The emulator's program, moved on by hand."""

    def __init__(self, path: Path) -> None:
        self.plc = Plc(read_map(path), EmulatorClock(0.0, 0.0, 1.0))
        self.now = 0.0
        self.plc.begin(self.now)

    async def permit(self, on: bool) -> None:
        self.plc.permit = on

    async def write(self, offset: int, words: Sequence[int], block: int = 0) -> None:
        place = self.plc.registers.blocks[block].place
        self.plc.write("suite", place.table, place.address + offset, words, self.now)

    async def wait(self, seconds: float) -> None:
        self.now += seconds

    async def account(self, block: int = 0) -> Account:
        self.now += CYCLE_MS / 1000
        self.plc.cycle(self.now)
        truth, suffix = self.plc.image.truth, self.plc.registers.blocks[block].suffix
        accepted, refused, code, usable, *session = (int(truth[f"{name}{suffix}"] or 0) for name in STATUS_TAGS)
        return Account(accepted, refused, code, bool(usable), *session)


class Compiled:
    """The generated example program in its interpreter: registers in, registers out, as a soft PLC has them."""

    def __init__(self, path: Path, change: Callable[[str], str] = lambda text: text) -> None:
        self.device = load_device(path)
        self.program: Instance = parsed(change(generate(self.device, "GATEWAY_BLOCK", Program()))).new(
            "GATEWAY_BLOCK_MAIN"
        )
        self.by_place = {place: name for name, place in self.program.places.items()}
        self.ms = 0
        self.program.call(self.ms)

    @property
    def block(self) -> Instance:
        """The function block's instance."""
        found: Instance = self.program["Gateway"]
        return found

    def word(self, tag: str) -> int:
        address = self.device.by_name[tag].address.partition(":")[2]
        return int(self.program[self.by_place[f"%MW{address}"]])

    async def permit(self, on: bool) -> None:
        self.program.values["permitswitch"] = on

    async def write(self, offset: int, words: Sequence[int], block: int = 0) -> None:
        for tag, word in zip(self.device.writebacks[block].words[offset:], words, strict=False):
            self.program.values[self.by_place[f"%MW{tag.address.partition(':')[2]}"]] = word

    async def wait(self, seconds: float) -> None:
        # While nothing is written only the timer runs, which looks at the clock: it needs no short cycles.
        cycles = round(1000 * seconds / CYCLE_MS)
        while cycles > 0:
            self.run(min(cycles, LONG_CYCLE))
            cycles -= LONG_CYCLE

    def run(self, cycles: int = 1) -> None:
        """One cycle that takes as long as so many."""
        self.ms += cycles * CYCLE_MS
        self.program.call(self.ms)

    async def account(self, block: int = 0) -> Account:
        self.run()
        layout = self.device.writebacks[block]
        accepted, refused, code, usable, *session = (self.word(layout.tag(name)) for name in STATUS_TAGS)
        return Account(accepted, refused, code, bool(usable & 1), *session)


class SeveralBlocks(Protocol):
    """A PLC under test with its blocks by number."""

    async def permit(self, on: bool) -> None: ...
    async def write(self, offset: int, words: Sequence[int], block: int) -> None: ...
    async def wait(self, seconds: float) -> None: ...
    async def account(self, block: int) -> Account: ...


class Beside:
    """One block of a PLC as a side of its own: one program and one clock for all."""

    def __init__(self, plc: SeveralBlocks, block: int) -> None:
        self.plc, self.block = plc, block

    async def permit(self, on: bool) -> None:
        await self.plc.permit(on)

    async def write(self, offset: int, words: Sequence[int]) -> None:
        await self.plc.write(offset, words, self.block)

    async def wait(self, seconds: float) -> None:
        await self.plc.wait(seconds)

    async def account(self) -> Account:
        return await self.plc.account(self.block)
