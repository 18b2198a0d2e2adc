"""What a command loads before it works, its help included: none of the libraries that its work needs."""

import json
import re
import subprocess
import sys
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
PROGRAM = """
import json, sys
import click
from gateway.cli.main import main

paths, heavy = json.loads(sys.argv[1])
loaded = {}
for path in paths:
    command, context = main, None
    for name in path:
        context = click.Context(command, parent=context)
        command = command.get_command(context, name)
    command.get_help(click.Context(command, info_name=path[-1], parent=context))
    loaded[" ".join(path)] = [each for each in heavy if each in sys.modules]
print(json.dumps([loaded, len(sys.modules)]))
"""


def dearest(report: str, most: int = 10) -> list[str]:
    """The modules of an import-time report that took longest by themselves, with the microseconds."""
    rows = re.findall(r"^import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)$", report, re.MULTILINE)
    return [f"{name}: {micros}" for micros, name in sorted(rows, key=lambda row: -int(row[0]))[:most]]


def test_the_help_of_no_leaf_loads_what_only_its_work_needs() -> None:
    paths = [path for path, _ in command_paths()]
    command = [sys.executable, "-P", "-X", "importtime", "-c", PROGRAM, json.dumps([paths, HEAVY])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print("dearest imports of all commands together (us):", *dearest(done.stderr), sep="\n  ")
    assert done.returncode == 0, done.stderr[-2000:]
    loaded, modules = json.loads(done.stdout)
    assert loaded == {" ".join(path): [] for path in paths}
    assert modules <= MOST_MODULES


@pytest.mark.parametrize(("command", "kinds"), [(scan, KINDS), (write_test, TESTS), (emulator, LIVE_PLANTS)])
def test_words_that_are_written_out_are_those_of_the_work(command: click.Command, kinds: dict[str, Any]) -> None:
    offered = next(kind.choices for each in command.params if isinstance(kind := each.type, click.Choice))
    assert list(offered) == list(kinds)


def test_the_dearest_imports_are_told_by_their_own_time() -> None:
    report = "import time:        7 |         90 | a\nimport time:       80 |         80 |   a.b\n"
    assert dearest(report) == ["a.b: 80", "a: 7"]
