"""The PLCs that the conformance suite is put to: the emulator's program, and the generated Structured Text."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path

from gateway.commission.writeback.block_writer import ACCOUNT_TAGS
from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.suite import Account, in_session
from gateway.commission.writeback.vectors import SuiteStep
from gateway.settings.devices import BLOCK_FIELDS, load_device
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.plc import Plc
from sim.plc.program.registers import read_map
from tests.plc_side.structured_text import Instance, Text

CYCLE_MS = 20


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

    async def write(self, offset: int, words: Sequence[int]) -> None:
        layout = self.plc.registers.block
        assert layout is not None
        self.plc.write("suite", layout.place.table, layout.place.address + offset, words, self.now)

    async def wait(self, seconds: float) -> None:
        self.now += seconds

    async def account(self) -> Account:
        self.now += CYCLE_MS / 1000
        self.plc.cycle(self.now)
        truth = self.plc.image.truth
        accepted, refused, code, usable, *session = (int(truth[name] or 0) for name in ACCOUNT_TAGS)
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

    async def write(self, offset: int, words: Sequence[int]) -> None:
        assert self.device.writeback is not None
        for tag, word in zip(self.device.writeback.words[offset:], words, strict=False):
            self.program.values[self.by_place[f"%MW{tag.address.partition(':')[2]}"]] = word

    async def wait(self, seconds: float) -> None:
        self.run(round(1000 * seconds / CYCLE_MS))

    def run(self, cycles: int) -> None:
        for _ in range(cycles):
            self.ms += CYCLE_MS
            self.program.call(self.ms)

    async def account(self) -> Account:
        self.run(1)
        accepted, refused, code, usable, *session = (self.word(name) for name in ACCOUNT_TAGS)
        return Account(accepted, refused, code, bool(usable & 1), *session)
