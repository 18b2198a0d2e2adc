"""Linear algebra has one thread in every command: said before numpy is loaded, and as a person has set it."""

import json
import os
import subprocess
import sys

import pytest

from gateway.entry.threads import VARIABLES
from tests.cli.support import ROOT, command_paths

WALK = """
import json, os, runpy, sys, warnings

warnings.simplefilter("ignore", RuntimeWarning)
given = dict(os.environ)
variables, every = map(json.loads, sys.argv[1:])


class Met(BaseException):
    pass


class BeforeNumpy:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy":
            raise Met


def become(*_):
    raise Met


def told(run):
    os.environ.clear()
    os.environ.update(given)
    try:
        run()
    except Met:
        return [os.environ.get(variable) for variable in variables]
    except SystemExit:
        return "not loaded"


sys.meta_path.insert(0, BeforeNumpy())
os.execv = become
sys.stdout, answers = sys.stderr, {}
for module in ("decanter_gateway", "gateway.cli.main"):
    for command in ([], ["diagnose", "--model", "nothing", "--traces", "nothing", "--out", "nothing"]):
        sys.argv = ["decanter", *(command or ["--help"])]
        answers[" ".join([module, *command[:1]])] = told(lambda: runpy.run_module(module, run_name="__main__"))

from gateway.cli.main import main

for command in every:
    answers[" ".join(command)] = told(lambda: main.main([*command, "--help"]))
# Its help needs no numpy, its work does.
answers["model learn"] = told(lambda: main.main(["model", "learn", "--traces", "nothing", "--out", "nothing"]))
print(json.dumps(answers), file=sys.__stdout__)
"""
"""What each command's environment says when it is about to load numpy or to become another program, which it then may
not: a process for them all."""


def clean(**given: str) -> dict[str, str]:
    """This process's environment, with what is `given` of the variables and no other of them."""
    return {name: value for name, value in os.environ.items() if name not in VARIABLES} | given


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ({}, ["1", "1", "1"]),
        ({"OPENBLAS_NUM_THREADS": "3"}, ["1", "3", "1"]),
        ({"OMP_NUM_THREADS": "4"}, ["4", "4", "4"]),
    ],
    ids=["nothing", "of one library", "of all libraries"],
)
def test_every_command_has_said_how_many_threads_before_numpy_is_loaded(
    given: dict[str, str], wanted: list[str]
) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WALK, json.dumps(VARIABLES), json.dumps([words for words, _ in command_paths()])],
        cwd=ROOT,
        env=clean(**given),
        capture_output=True,
        text=True,
        check=True,
    )
    answers = json.loads(done.stdout)
    loading = {command: answer for command, answer in answers.items() if answer != "not loaded"}
    assert {command: answer for command, answer in loading.items() if answer != wanted} == {}
    assert {"decanter_gateway diagnose", "gateway.cli.main diagnose", "emulate", "model learn"} <= set(loading)
    assert len(answers) > 60
    # What answers at once: numpy alone takes half of the 0.2 s that the help has.
    assert {answers["decanter_gateway"], answers["gateway.cli.main"]} == {"not loaded"}


def test_worker_processes_have_the_threads_of_the_command() -> None:
    code = "from gateway.entry.threads import *; import os; one_thread(); from sim.lab.workers import parallel; "
    code += "print(*parallel(os.environ.get, VARIABLES, 2))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=ROOT,
        env=clean(OPENBLAS_NUM_THREADS="5"),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["1", "5", "1"]
