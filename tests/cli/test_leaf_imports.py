"""What a command loads before it begins, its help included: the libraries that it may need, and none besides."""

import json
import os
import re
import subprocess
import sys

from tests.cli.support import command_paths

STEPS: tuple[tuple[frozenset[str], str], ...] = (
    (
        frozenset(),
        """diagnose docs completion emulate historian-import model-check model-export model-learn
        model-learn-correction model-learn-fleet model-learn-model model-learn-settings model-judge model-judge-proof
        model-judge-rank model-judge-regression model-judge-skill model-judge-validation model-version
        model-version-cycles model-version-lineage model-version-retrain model-version-shadow keep plc-check
        trace-ingest alarm historian machine user""",
    ),
    (
        frozenset({"asyncio"}),
        """arm audit disarm plc-check-device plc-check-files plc-check-hmi plc-check-plan plc-check-soak
        plc-bind plc-check-computer plc-guess plc-import plc-probe plc-replay plc-report plc-served""",
    ),
    (
        frozenset({"pydantic"}),
        """reload run alarm-list alarm-show alarm-acknowledge alarm-shelve alarm-unshelve alarm-remove-from-service
        alarm-return alarm-reset alarm-journal alarm-rates historian-export historian-query historian-tables
        plc-codegen plc-read plc-scan trace-can""",
    ),
    (frozenset({"tomlkit"}), "init machine-add machine-list machine-remove"),
    (
        frozenset({"cryptography", "sqlite3"}),
        "certificates demo keep-diff keep-history keep-rollback keep-backup keep-restore keep-support plc-check-write",
    ),
    (frozenset({"numpy"}), "model-version-promote model-show model-simulate trace-map trace-show trace-synth"),
    (frozenset({"rich", "argon2", "scipy"}), "top user-add user-list user-password user-remove"),
)
"""What the commands of a step may load beside what those of the steps before may; their order is that of loading."""
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
PROGRAM = """
import json, sys
import click
from gateway.cli.main import main

def leaf(path):
    command, context = main, None
    for name in path:
        context = click.Context(command, parent=context)
        command = command.get_command(context, name)
    return command.get_help(click.Context(command, info_name=path[-1], parent=context))

order, heavy = json.loads(sys.argv[1])
loaded = {}
for path in order:
    leaf(path)
    loaded["-".join(path)] = [each for each in heavy if each in sys.modules]
print(json.dumps(loaded))
"""


def dearest(report: str, most: int = 10) -> list[str]:
    """The modules of an import-time report that took longest by themselves, with the microseconds."""
    rows = re.findall(r"^import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)$", report, re.MULTILINE)
    return [f"{name}: {micros}" for micros, name in sorted(rows, key=lambda row: -int(row[0]))[:most]]


def test_a_leaf_loads_no_library_that_it_has_no_use_for() -> None:
    known = {"-".join(path): path for path, _ in command_paths()}
    named = [name for _, names in STEPS for name in names.split()]
    assert sorted(known) == sorted(named), "a command without a place in STEPS, or a place without a command"
    order = [known[name] for name in named]
    command = [sys.executable, "-P", "-X", "importtime", "-c", PROGRAM, json.dumps([order, HEAVY])]
    environment = {**os.environ, "PYDANTIC_DISABLE_PLUGINS": "__all__"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    print("dearest imports of all commands together (us):", *dearest(done.stderr), sep="\n  ")
    assert done.returncode == 0, done.stderr[-2000:]
    loaded: dict[str, list[str]] = json.loads(done.stdout)
    may: set[str] = set()
    for step, names in STEPS:
        may |= step
        assert {name: sorted({*loaded[name]} - may) for name in names.split()} == {name: [] for name in names.split()}


def test_the_dearest_imports_are_told_by_their_own_time() -> None:
    report = "import time:        7 |         90 | a\nimport time:       80 |         80 |   a.b\n"
    assert dearest(report) == ["a.b: 80", "a: 7"]
