"""The generated text compiled by matiec and run: a compiler that is not ours, and the whole conformance suite."""

import os
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.suite import Account, put_through
from gateway.commission.writeback.vectors import vectors
from gateway.settings.devices import BLOCK_FIELDS, load_device
from tests.plc_side.sides import CYCLE_MS
from tests.plc_side.test_structured_text import PLC

HARNESS = Path(__file__).parent / "compiled.c"


class CompiledByMatiec:
    """The compiled program as a process whose cycles the test counts."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def tell(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    async def permit(self, on: bool) -> None:
        self.tell(f"p {int(on)}")

    async def write(self, offset: int, words: Sequence[int]) -> None:
        self.tell(f"w {offset} {len(words)} {' '.join(map(str, words))}")

    async def wait(self, seconds: float) -> None:
        self.tell(f"c {round(1000 * seconds / CYCLE_MS)}")

    async def account(self) -> Account:
        self.tell("c 1\na")
        assert self.process.stdout is not None
        accepted, refused, code, usable, *session = map(int, self.process.stdout.readline().split())
        return Account(accepted, refused, code, bool(usable & 1), *session)


@contextmanager
def compiled(folder: Path) -> Iterator[CompiledByMatiec]:
    """The shipped map's text, compiled to C by iec2c and by the machine's own compiler."""
    iec2c, gcc = os.environ.get("IEC2C") or shutil.which("iec2c"), shutil.which("gcc")
    if iec2c is None or gcc is None:
        pytest.skip("matiec (iec2c by PATH or by the variable IEC2C) or gcc is not installed on this machine")
    library = Path(iec2c).resolve().parent / "lib"
    (folder / "block.st").write_text(generate(load_device(PLC), "GATEWAY_BLOCK", Program()), encoding="ascii")
    for command in (
        [iec2c, "-I", str(library), "block.st"],
        [gcc, "-w", "-I", str(library / "C"), "-I.", "-o", "plc", str(HARNESS), "Config0.c", "Resource0.c"],
    ):
        names = [
            {"Config0.c": "GATEWAY_BLOCK_CONFIGURATION.c", "Resource0.c": "MainResource.c"}.get(word, word)
            for word in command
        ]
        done = subprocess.run(names, cwd=folder, capture_output=True, check=False, timeout=60)
        assert done.returncode == 0, done.stderr.decode()
    with subprocess.Popen([str(folder / "plc")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield CompiledByMatiec(process)
        finally:
            process.kill()


async def test_the_text_that_matiec_has_compiled_passes_the_whole_suite(tmp_path: Path) -> None:
    device = load_device(PLC)
    assert device.writeback is not None
    with compiled(tmp_path) as side:
        steps = vectors(device.writeback)
        results = await put_through(steps, side, device.refusals, BLOCK_FIELDS)
    print(f"{sum(result.passed for result in results)} of {len(results)} steps of the conformance suite")
    assert [result for result in results if not result.passed] == []
