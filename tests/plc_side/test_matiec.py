"""The generated text compiled by matiec and run: a compiler that is not ours, and the whole conformance suite."""

import os
import re
import shutil
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest

from gateway.commission.writeback.structured_text import Program, generate
from gateway.commission.writeback.suite import Account, Result, run_steps, run_suite
from gateway.commission.writeback.targets import TARGETS
from gateway.commission.writeback.vectors import joint_steps, vectors
from gateway.settings.devices import BLOCK_FIELDS, load_device
from tests.plc_side.sides import CYCLE_MS, Beside
from tests.plc_side.test_conformance import MUTANTS
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

    async def write(self, offset: int, words: Sequence[int], block: int = 0) -> None:
        self.tell(f"w {block} {offset} {len(words)} {' '.join(map(str, words))}")

    async def wait(self, seconds: float) -> None:
        self.tell(f"c {round(1000 * seconds / CYCLE_MS)}")

    async def account(self, block: int = 0) -> Account:
        self.tell(f"c 1\na {block}")
        assert self.process.stdout is not None
        accepted, refused, code, usable, *session = map(int, self.process.stdout.readline().split())
        return Account(accepted, refused, code, bool(usable & 1), *session)


@dataclass(frozen=True)
class Layout:
    """Where a target's text has what the harness reaches for: the configuration, the instance, each block's areas."""

    configuration: str
    resource: str
    blocks: str
    accounts: str


LAYOUTS = {
    "plain": Layout(
        "GATEWAY_BLOCK_CONFIGURATION",
        "MainResource",
        "&M_words[400],&M_words[430]",
        "&M_words[115],&M_words[123]",
    ),
    "openplc": Layout("Config0", "Res0", "&Q_words[400],&Q_words[430]", "&Q_words[115],&Q_words[123]"),
    "codesys": Layout(
        "GATEWAY_BLOCK_CONFIGURATION",
        "MainResource",
        "MAIN.AREA.value.table,MAIN.AREAALIMENTAZIONE.value.table",
        "MAIN.ANSWERS.value.table+3,MAIN.ANSWERS.value.table+11",
    ),
}


@pytest.fixture(scope="module")
def iec2c() -> str:
    found = os.environ.get("IEC2C") or shutil.which("iec2c")
    if shutil.which("gcc") is None:
        pytest.skip("needs a C compiler (apt-get install gcc libc6-dev)")
    if found is None:
        pytest.skip("needs matiec (iec2c by PATH or by the variable IEC2C; Debian does not have it)")
    return found


def text_of(target: str) -> str:
    device = load_device(PLC)
    content = generate(device, "GATEWAY_BLOCK", Program(), TARGETS[target])
    if target == "codesys":
        # CODESYS keeps its tasks in the project, and locates whole arrays, which matiec does not: the harness finds
        # the arrays in the program's instance, and the configuration is that of the plain text.
        content = (
            re.sub(r" AT %[IQ]W\d+", "", content)
            + generate(device, "GATEWAY_BLOCK", Program()).partition("END_PROGRAM\n")[2]
        )
    return content


def translated(iec2c: str, folder: Path, content: str) -> subprocess.CompletedProcess[bytes]:
    """iec2c over a text. Its library lies beside the program itself, also where PATH has but a link to it."""
    (folder / "block.st").write_text(content, encoding="ascii")
    library = Path(iec2c).resolve().parent / "lib"
    return subprocess.run(
        [iec2c, "-I", str(library), "block.st"], cwd=folder, capture_output=True, check=False, timeout=60
    )


@contextmanager
def compiled(iec2c: str, folder: Path, content: str, layout: Layout) -> Iterator[CompiledByMatiec]:
    """A text compiled to C by iec2c and by the machine's own compiler, running."""
    done = translated(iec2c, folder, content)
    assert done.returncode == 0, done.stderr.decode()
    includes = [f"-I{Path(iec2c).resolve().parent / 'lib' / 'C'}", "-I."]
    names = [
        f"-DMAIN={layout.resource.upper()}__MAININSTANCE",
        f"-DBLOCKS={layout.blocks}",
        f"-DACCOUNTS={layout.accounts}",
    ]
    sources = [str(HARNESS), f"{layout.configuration}.c", f"{layout.resource}.c"]
    done = subprocess.run(
        ["gcc", "-w", *includes, *names, "-o", "plc", *sources],
        cwd=folder,
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr.decode()
    with subprocess.Popen([str(folder / "plc")], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield CompiledByMatiec(process)
        finally:
            process.kill()


async def results_of(iec2c: str, folder: Path, target: str, change: tuple[str, str] = ("", "")) -> list[Result]:
    """The steps of every block by itself, and of all together."""
    device = load_device(PLC)
    assert device.writeback is not None
    content = text_of(target)
    assert change[0] in content
    with compiled(iec2c, folder, content.replace(*change) if change[0] else content, LAYOUTS[target]) as plc:
        sides = [Beside(plc, layout.place) for layout in device.writebacks]
        results = []
        for side in sides:
            results += await run_suite(vectors(device.writeback), side, device.refusals, BLOCK_FIELDS)
        return results + await run_steps(joint_steps(device.writeback), sides, device.refusals, BLOCK_FIELDS)


@pytest.mark.parametrize("target", LAYOUTS)
async def test_the_text_that_matiec_has_compiled_passes_the_whole_suite_for_each_block_and_for_both(
    iec2c: str, tmp_path: Path, target: str
) -> None:
    results = await results_of(iec2c, tmp_path, target)
    print(f"{target}: {sum(result.passed for result in results)} of {len(results)} steps of the conformance suite")
    assert [result for result in results if not result.passed] == []


@pytest.mark.parametrize("name", MUTANTS)
async def test_a_compiled_text_that_leaves_a_check_out_fails_the_suite(iec2c: str, tmp_path: Path, name: str) -> None:
    results = await results_of(iec2c, tmp_path, "plain", MUTANTS[name])
    print(f"{name}: {sum(bool(result.wrong) for result in results)} steps notice")
    assert any(result.wrong for result in results)


@pytest.mark.parametrize("name", ["decanter_can.toml", "decanter_canopen.toml"])
def test_the_maps_of_the_can_links_compile_too(iec2c: str, tmp_path: Path, name: str) -> None:
    done = translated(iec2c, tmp_path, generate(load_device(PLC.parent / name), "", Program()))
    assert done.returncode == 0, done.stderr.decode()


def test_an_iec2c_that_is_but_a_link_finds_its_library(iec2c: str, tmp_path: Path) -> None:
    link = tmp_path / "iec2c"
    link.symlink_to(Path(iec2c).resolve())
    done = translated(str(link), tmp_path, text_of("plain"))
    assert done.returncode == 0, done.stderr.decode()
