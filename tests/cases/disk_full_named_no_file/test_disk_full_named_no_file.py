"""A full disk was "no space left on device", and nobody knew which of the files was meant."""

import ast
from pathlib import Path

import pytest
from click.testing import CliRunner

from drivers.named_files import name_write_errors
from gateway.cli.main import main
from sim.files import write_durably
from sim.lab.pictures import save_picture
from sim.lab.recordings import write_trace
from sim.plant.scenarios import scenario
from tests.gateway.support import ROOT

FULL = Path("/dev/full")
EXPORT = ROOT / "tests" / "validation" / "exports" / "zenon_trend.csv"
pytestmark = pytest.mark.skipif(not FULL.exists(), reason="this system has no /dev/full")


def test_the_sentence_names_the_file_and_what_helps() -> None:
    done = CliRunner().invoke(main, ["trace", "map", str(EXPORT), "-o", str(FULL), "--overwrite"])
    assert done.exit_code == 2
    assert (
        done.stderr == "decanter: /dev/full: no space left on device; make room there, or give a path on another disk\n"
    )


def test_every_writer_of_a_result_names_its_file() -> None:
    class _Figure:
        def savefig(self, target: Path, **_: object) -> None:
            Path(target).write_bytes(b"x")

    for write in (
        lambda: write_durably(FULL, "text"),
        lambda: write_trace(scenario("cd1", 0), FULL),
        lambda: save_picture(_Figure(), FULL, "png"),  # type: ignore[arg-type]
    ):
        with pytest.raises(OSError) as raised:
            write()
        assert raised.value.filename == str(FULL)


def test_an_error_that_names_another_file_keeps_it(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as raised, name_write_errors(tmp_path / "a"):
        (tmp_path / "no" / "b").write_text("x")
    assert raised.value.filename == str(tmp_path / "no" / "b")


ELSEWHERE = {
    "gateway/plant/status.py": "the running gateway's own records say where they lie",
    "gateway/demo": "files of a folder that the demo has just made, and says",
    "sim/plc": "the emulator's own",
}


def test_no_command_writes_a_text_outside_of_it() -> None:
    """Each `write_text`, `write_bytes` and `savefig` stands in a `with name_write_errors(...)`."""
    bare = []
    for room in ("gateway", "sim"):
        for path in sorted((ROOT / room).rglob("*.py")):
            name = str(path.relative_to(ROOT))
            if any(name.startswith(place) for place in ELSEWHERE):
                continue
            text = path.read_text(encoding="utf-8")
            if not any(call in text for call in (".write_text(", ".write_bytes(", ".savefig(")):
                continue
            tree = ast.parse(text)
            inside = {
                id(node)
                for block in ast.walk(tree)
                if isinstance(block, ast.With)
                and any("name_write_errors(" in ast.unparse(item) for item in block.items)
                for node in ast.walk(block)
            }
            for node in ast.walk(tree):
                if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)) or id(node) in inside:
                    continue
                # Click's help formatter has a method of that name, and no file.
                if (
                    node.func.attr in ("write_text", "write_bytes", "savefig")
                    and ast.unparse(node.func.value) != "formatter"
                ):
                    bare.append(f"{name}:{node.lineno}")
    assert bare == []
