"""What a command loads: for its help none of the libraries that its work needs, for its work none besides."""

import json
import re
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import click
import pytest

from gateway.commission.commands import scan
from gateway.commission.commands import test as write_test
from gateway.commission.scan import KINDS
from gateway.commission.writeback.test import TESTS
from sim.plc.__main__ import main as emulator
from sim.plc.program import LIVE_PLANTS
from tests.cli.support import command_paths

HEAVY = [
    "aalpy",
    "argon2",
    "asammdf",
    "asyncio",
    "asyncua",
    "can",
    "canopen",
    "cantools",
    "cryptography",
    "fpdf",
    "jinja2",
    "joblib",
    "lark",
    "matplotlib",
    "numba",
    "numpy",
    "openpyxl",
    "paho",
    "pandas",
    "psycopg",
    "pyarrow",
    "pydantic",
    "pydot",
    "pymodbus",
    "rich",
    "scipy",
    "scipy.stats",
    "sklearn",
    "sqlite3",
    "starlette",
    "structlog",
    "tomlkit",
    "uvicorn",
    "xgboost",
]
"""Libraries that cost more than a help text."""
MOST_MODULES = 270
"""What the help of all commands together may load: one process that loads it takes a quarter of a second."""
STEPS: tuple[tuple[frozenset[str], str], ...] = (
    (
        frozenset(),
        """demo emulate docs completion keep plc-check machine alarm historian user model-learn model-judge
        model-version alarm-acknowledge alarm-shelve alarm-unshelve alarm-remove-from-service
        alarm-return alarm-reset""",
    ),
    (frozenset({"pydantic"}), "plc-codegen historian-export historian-query historian-tables trace-can"),
    (
        frozenset({"asyncio"}),
        """run reload plc-probe plc-scan plc-read plc-check-computer plc-served alarm-list alarm-show alarm-journal
        alarm-rates""",
    ),
    (frozenset({"tomlkit"}), "init plc-bind plc-import plc-check-soak machine-list machine-add machine-remove"),
    (frozenset({"rich", "argon2"}), "top user-add user-list user-password user-remove"),
    (
        frozenset({"cryptography", "sqlite3"}),
        """certificates arm disarm audit keep-backup keep-restore keep-history keep-diff keep-rollback keep-support
        plc-check-files plc-check-plan plc-check-device plc-check-write plc-report""",
    ),
    (
        frozenset({"numpy"}),
        """model-show model-version-promote model-simulate model-judge-proof trace-map trace-show trace-synth plc-guess
        plc-check-hmi historian-import""",
    ),
    (frozenset({"structlog"}), "plc-replay"),
    (frozenset({"lark"}), "trace-ingest"),
    (
        frozenset({"scipy"}),
        """diagnose model-learn-model model-learn-correction model-export model-check model-learn-settings
        model-learn-fleet model-version-cycles model-version-retrain model-version-shadow model-version-lineage
        model-judge-skill model-judge-validation model-judge-rank model-judge-regression""",
    ),
)
"""What the work of a step's commands may load when it begins, beside what those before may; they are loaded in turn."""
PROGRAM = """
import ast, inspect, json, sys, textwrap
from importlib import import_module
import click
from gateway.cli.main import main

paths, heavy, begins = json.loads(sys.argv[1])
loaded = {}
for path in paths:
    command, context = main, None
    for name in path:
        context = click.Context(command, parent=context)
        command = command.get_command(context, name)
    command.get_help(click.Context(command, info_name=path[-1], parent=context))
    if begins and command.callback:
        source = textwrap.dedent(inspect.getsource(inspect.unwrap(command.callback)))
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.ImportFrom) and any(name.asname == "work" for name in node.names):
                import_module(node.module)
    loaded["-".join(path)] = [each for each in heavy if each in sys.modules]
print(json.dumps([loaded, len(sys.modules)]))
"""


def dearest(report: str, most: int = 10) -> list[str]:
    """The modules of an import-time report that took longest by themselves, with the microseconds."""
    rows = re.findall(r"^import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)$", report, re.MULTILINE)
    return [f"{name}: {micros}" for micros, name in sorted(rows, key=lambda row: -int(row[0]))[:most]]


def loads(paths: Sequence[Sequence[str]], *, begins: bool) -> tuple[dict[str, list[str]], int]:
    """The heavy libraries that are there after each command in turn, and how many modules after all."""
    command = [sys.executable, "-P", "-X", "importtime", "-c", PROGRAM, json.dumps([paths, HEAVY, begins])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print("dearest imports of all commands together (us):", *dearest(done.stderr), sep="\n  ")
    assert done.returncode == 0, done.stderr[-2000:]
    loaded, modules = json.loads(done.stdout)
    return loaded, modules


def test_the_help_of_no_leaf_loads_what_only_its_work_needs() -> None:
    paths = [path for path, _ in command_paths()]
    loaded, modules = loads(paths, begins=False)
    assert loaded == {"-".join(path): [] for path in paths}
    assert modules <= MOST_MODULES


def test_the_work_of_a_leaf_begins_with_no_library_that_it_has_no_use_for() -> None:
    known = {"-".join(path): path for path, _ in command_paths()}
    named = [name for _, names in STEPS for name in names.split()]
    assert sorted(known) == sorted(named), "a command without a place in STEPS, or a place without a command"
    loaded, _ = loads([known[name] for name in named], begins=True)
    may: set[str] = set()
    for step, names in STEPS:
        may |= step
        assert {name: sorted({*loaded[name]} - may) for name in names.split()} == {name: [] for name in names.split()}
    assert "scipy" in loaded[named[-1]], "the work of no command was loaded"


@pytest.mark.parametrize(("command", "kinds"), [(scan, KINDS), (write_test, TESTS), (emulator, LIVE_PLANTS)])
def test_words_that_are_written_out_are_those_of_the_work(command: click.Command, kinds: dict[str, Any]) -> None:
    offered = next(kind.choices for each in command.params if isinstance(kind := each.type, click.Choice))
    assert list(offered) == list(kinds)


def test_the_dearest_imports_are_told_by_their_own_time() -> None:
    report = "import time:        7 |         90 | a\nimport time:       80 |         80 |   a.b\n"
    assert dearest(report) == ["a.b: 80", "a: 7"]
