"""House rules that no linter knows: what start-up imports, what may lie in the tree, one sentence over each module."""

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import click
import pytest

from gateway.cli.main import main
from gateway.entry.lazy import FirstWordCommand, LazyGroup
from tests.conftest import COMPUTING

ROOT = Path(__file__).parent.parent
SOURCES = sorted(path for room in ("drivers", "sim", "gateway") for path in (ROOT / room).rglob("*.py"))
HEAVY = (
    *("numpy", "pandas", "scipy", "matplotlib", "pymodbus", "pydantic", "rich", "structlog", "lark", "pydot"),
    *("jinja2", "fpdf", "joblib", "optuna", "distributed", "dask", "sklearn"),
    *("can", "cantools", "canopen", "cryptography", "serial"),
    *("starlette", "uvicorn", "argon2"),
)


def test_every_module_opens_with_a_true_sentence() -> None:
    opened = {path: ast.get_docstring(ast.parse(path.read_bytes())) or "" for path in SOURCES}
    assert [
        str(path.relative_to(ROOT))
        for path, docstring in opened.items()
        if path.name != "__init__.py" and not docstring.partition("\n")[0].rstrip().endswith((".", ":"))
    ] == []


def modules_imported_by(code: str) -> set[str]:
    """Top-level modules present after running `code` in a fresh interpreter."""
    script = f"{code}\nimport sys\nprint(' '.join(sorted({{name.partition('.')[0] for name in sys.modules}})))"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.splitlines()[-1].split())


GROUPS = ["", "model", "trace", "plc", "alarm"]
"""Their help lists commands without loading one. What a command's own help loads: tests/cli/test_leaf_imports.py."""


def test_help_imports_nothing_heavy() -> None:
    code = (
        "from click.testing import CliRunner\n"
        "from gateway.cli.main import main\n"
        f"for group in {GROUPS}:\n"
        "    assert CliRunner().invoke(main, [*group.split(), '--help']).exit_code == 0"
    )
    assert modules_imported_by(code).isdisjoint(HEAVY)


def test_what_a_test_compiles_is_kept_for_the_next_process() -> None:
    assert not sys.dont_write_bytecode and "PYTHONDONTWRITEBYTECODE" not in os.environ


def test_a_model_is_shown_without_grammar_and_settings() -> None:
    assert modules_imported_by("import gateway.lab.models.show").isdisjoint({"lark", "pydantic"})


def test_a_gateway_imports_nothing_that_draws_edits_files_sends_mail_or_serves_a_page() -> None:
    code = "import gateway.plant.app, drivers.modbus.driver, sys; assert 'gateway.outside.web' not in sys.modules"
    loaded = modules_imported_by(code)
    assert loaded.isdisjoint({"pandas", "matplotlib", "rich", "pygments", "tomlkit", "smtplib", "http"})
    assert loaded.isdisjoint({"starlette", "uvicorn", "argon2", "h11", "anyio", "jinja2"})


def test_the_log_hides_rich_from_its_own_library_only() -> None:
    assert "rich" in modules_imported_by("import gateway.plant.log, rich.console")


def test_the_durations_name_tests_that_are_there() -> None:
    tests = ROOT / "tests"
    named = {name.partition("[")[0] for name in json.loads((tests / "durations.json").read_text(encoding="utf-8"))}
    there: set[str] = set()
    for file in {name.partition("::")[0] for name in named}:
        text = (ROOT / file).read_text(encoding="utf-8") if (ROOT / file).is_file() else ""
        functions = re.findall(r"^\s*(?:async )?def (\w+)", text, flags=re.MULTILINE)
        there.update(f"{file}::{function}" for function in functions)
    assert named <= there, f"`make durations` measures anew; not there: {sorted(named - there)}"


def test_what_mutants_are_made_of_and_tried_by_is_there() -> None:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["mutmut"]["tests"]
    assert table and all((ROOT / path).exists() for module, tests in table.items() for path in (module, *tests))


def test_every_room_that_only_computes_is_one() -> None:
    assert all(list((ROOT / "tests" / room).glob("test_*.py")) for room in COMPUTING)


def test_no_measured_data_lies_in_the_project() -> None:
    tracked = subprocess.run(["git", "ls-files", "-z"], capture_output=True, text=True, check=False, cwd=ROOT)
    if tracked.returncode != 0:
        pytest.skip("not a git checkout")
    files = [ROOT / name for name in tracked.stdout.split("\0") if name]
    too_large = [str(path) for path in files if path.is_file() and path.stat().st_size > 1_500_000]
    assert too_large == []


def lazy_commands(
    group: LazyGroup | FirstWordCommand, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], str, click.Command]]:
    """Every command of the tables: its words, its line in the table, and the command itself."""
    context = click.Context(group)
    for name, (_, line) in group.table.items():
        command = group.get_command(context, name)
        assert command is not None
        yield (*words, name), line, command
        if isinstance(command, FirstWordCommand):
            yield from lazy_commands(command, (*words, name))
    for name, inner in group.commands.items() if isinstance(group, LazyGroup) else ():
        assert isinstance(inner, LazyGroup | FirstWordCommand)
        yield from lazy_commands(inner, (*words, name))


def test_the_tables_line_of_a_command_is_the_commands_own() -> None:
    different = {
        " ".join(words): (line, own)
        for words, line, command in lazy_commands(main)
        if (own := command.get_short_help_str(limit=1000)) != line
    }
    assert different == {}
