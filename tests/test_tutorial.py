"""The tutorial's commands run, in their order, in an empty folder; the documentation's tables are the program's own."""

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from benchmarks.unknown_plc import write_examples
from sim.lab.recordings.column_map import load_map
from tests.cli.support import decanter
from tests.commission.bench import free_port
from tests.rig.no_bands import without_bands

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


PAGES = {
    "tutorial.md": ("cd8.png", "simulated.png", "model/model.json"),
    "commissioning.md": ("devices/plc.toml", "decanter.st", "acceptance/report.pdf"),
    "laboratory.md": ("lsha/learning_report.md", "campaign/index.html", "ranking.html", "uppaal/decanter_cd1.xml"),
}
"""The pages that are followed, and what must be there in the end."""
PORTS = ("15020", "15021")
"""Of the pages' software PLCs; a test takes free ones."""


def commands(page: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(r"^\$ (.+)$", text, flags=re.MULTILINE)


def plain_words(command: str) -> list[str] | None:
    """The words of a call of `decanter` with which a shell does nothing but take quotes off; None for any other."""
    outside = re.sub(r"'[^']*'", "", command)
    if not command.startswith("decanter ") or set(outside) & set('$`\\"|&;<>()*?[]~#'):
        return None
    return shlex.split(command)[1:]


def test_only_what_a_shell_leaves_as_it_is_stays_out_of_one() -> None:
    assert plain_words("decanter model check bins 'A[] not x'") == ["model", "check", "bins", "A[] not x"]
    for command in ("decanter check > x", "decanter run $CONFIG", "decanter show *.csv", "mkdir -p x", "decanter a; b"):
        assert plain_words(command) is None


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working folder; a process whose number a page keeps in it does not outlive the test."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for kept in tmp_path.glob("*.pid"):
        with suppress(ProcessLookupError):
            os.kill(int(kept.read_text(encoding="ascii")), signal.SIGKILL)


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_can_be_followed_literally(page: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first command of `decanter` and whatever a shell has a part in run in a shell, as a reader types them.

    The other calls of `decanter` are carried out in this process, which has its libraries loaded already, and learn
    without bands: the demonstration has some.
    """
    without_bands(monkeypatch)
    monkeypatch.setenv("CONFIG", str(ROOT / "config"))
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    assert len(commands(page)) >= 8
    known = False
    free = {port: str(free_port()) for port in PORTS}
    for line in commands(page):
        command = re.sub("|".join(PORTS), lambda port: free[port[0]], line)
        words = plain_words(command)
        if words is not None and known:
            result = decanter(*words)
            code, printed, complaints = result.exit_code, result.stdout, result.stderr
        else:
            done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=400, check=False)
            code, printed, complaints = done.returncode, done.stdout, done.stderr
            known = known or words is not None
        assert code == 0, f"{command}\n{printed}\n{complaints}"
        assert "Traceback" not in complaints
    for made in PAGES[page]:
        assert (folder / made).stat().st_size > 1000


def test_the_emulators_tables_in_the_documentation_are_those_that_it_prints() -> None:
    printed = subprocess.run(
        [sys.executable, "-m", "sim.plc", "--explain"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout
    assert printed.strip() in (DOCS / "emulator.md").read_text(encoding="utf-8")


def test_no_link_in_the_documentation_leads_nowhere() -> None:
    dead = []
    for page in sorted([*DOCS.rglob("*.md"), ROOT / "README.md"]):
        text = page.read_text(encoding="utf-8")
        # a query in code has brackets too, but no path in them
        targets = re.findall(r"\]\((\w[^)#\s]*|\.\.?/[^)#\s]*)\)", text)
        paths = [target for target in targets if "." in target and "://" not in target]
        dead += [(page.name, path) for path in paths if not (page.parent / path).exists()]
    assert dead == []


def test_every_file_that_the_documentation_names_is_there() -> None:
    gone = []
    for page in sorted([*DOCS.rglob("*.md"), *ROOT.glob("*.md")]):
        named = re.findall(r"`((?:drivers|sim|gateway|config|docs|tests)/[\w./-]+)`", page.read_text(encoding="utf-8"))
        assert named or page.name not in ("README.md", "architecture.md")
        gone += [(page.name, path) for path in sorted(set(named)) if not (ROOT / path.rstrip("/")).exists()]
    assert gone == []


def test_the_column_map_in_the_documentation_is_one(tmp_path: Path) -> None:
    (example,) = re.findall(r"```toml\n(.*?)```", (DOCS / "traces.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    path = tmp_path / "example.toml"
    path.write_text(example, encoding="utf-8")
    assert load_map(path).temperature == "MotorTemperature"


def test_the_examples_are_those_that_their_command_writes(tmp_path: Path) -> None:
    write_examples(tmp_path)
    examples = ROOT / "config" / "examples"
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(path.name for path in examples.iterdir())
    assert [path.name for path in tmp_path.iterdir() if path.read_bytes() != (examples / path.name).read_bytes()] == []
