"""The tutorial's commands run, in their order, in an empty folder; the documentation's tables are the program's own."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from sim.traces.column_map import load_map

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"


PAGES = {
    "tutorial.md": ("cd8.png", "simulated.png", "model/model.json"),
    "laboratory.md": ("lsha/learning_report.md", "campaign/index.html", "ranking.html", "uppaal/decanter_cd1.xml"),
}
"""The pages that are followed, and what must be there in the end."""


def commands(page: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(r"^\$ (.+)$", text, flags=re.MULTILINE)


@pytest.mark.slow
@pytest.mark.timeout(400)
@pytest.mark.parametrize("page", PAGES)
def test_a_tutorial_can_be_followed_literally(page: str, tmp_path: Path) -> None:
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
        "CONFIG": str(ROOT / "config"),
    }
    assert len(commands(page)) >= 8
    for command in commands(page):
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=90,
            check=False,
        )
        assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
    for made in PAGES[page]:
        assert (tmp_path / made).stat().st_size > 1000


def test_the_emulators_tables_in_the_documentation_are_those_that_it_prints() -> None:
    printed = subprocess.run(
        [sys.executable, "-m", "sim.plc", "--explain"], capture_output=True, text=True, check=True, cwd=ROOT
    ).stdout
    assert printed.strip() in (DOCS / "emulator.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", sorted([*DOCS.rglob("*.md"), ROOT / "README.md"]), ids=lambda page: page.name)
def test_no_link_in_the_documentation_leads_nowhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    targets = re.findall(
        r"\]\((\w[^)#\s]*|\.\.?/[^)#\s]*)\)", text
    )  # a query in code has brackets too, but no path in them
    targets = [target for target in targets if "." in target]
    assert [target for target in targets if "://" not in target and not (page.parent / target).exists()] == []


@pytest.mark.parametrize("room", ["README.md", "docs/architecture.md"])
def test_every_file_that_the_documentation_names_is_there(room: str) -> None:
    text = (ROOT / room).read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:drivers|sim|gateway|config|docs|tests)/[\w./-]+)`", text))
    assert named
    assert [path for path in sorted(named) if not (ROOT / path.rstrip("/")).exists()] == []


def test_the_column_map_in_the_documentation_is_one(tmp_path: Path) -> None:
    (example,) = re.findall(r"```toml\n(.*?)```", (DOCS / "traces.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    path = tmp_path / "example.toml"
    path.write_text(example, encoding="utf-8")
    assert load_map(path).temperature == "MotorTemperature"
