"""Every command of `plc` tells what it found in one way: data with a complaint, and a view of lines and tables."""

import ast
import json
from collections.abc import Iterator, Mapping
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from gateway.commission.session import failed, ok, result_of, step_lines, warning
from gateway.console import CommandResult, Line, Part, Rows, conclude
from gateway.entry import Exit
from tests.plc.bench import ROOT

PRINTS = {"echo", "secho", "print", "table", "emit", "print_json"}
BEFORE_THE_RESULT = {
    ("verify.py", "tell"): "the answer to a question, on standard error",
    ("watch.py", "_lines"): "each change as it comes",
    ("writeback/arm.py", "disarm"): "a plant file that cannot be used, on standard error",
    ("served.py", "served"): "the table as CSV, for another program",
}
FOUND = CommandResult({"rows": [{"tag": "T", "value": 1.5, "reason": None}]}, "T is hot", Exit.TIMEOUT)


def view(data: Mapping[str, Any]) -> Iterator[Part]:
    yield "as it stands"
    yield Line("in red", "red", bold=True)
    yield Rows("readings", ("tag", "value", "reason", "absent"), data["rows"])
    yield Rows("pairs", ("a", "b"), [(1, True)])


def told(result: CommandResult, *, as_json: bool) -> Result:
    return CliRunner().invoke(click.command()(lambda: conclude(result, view, as_json=as_json)), [])


def test_no_command_prints_its_result_by_itself() -> None:
    folder, printing = ROOT / "gateway" / "commission", set()
    for path in sorted(folder.rglob("*.py")):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
                calls = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
                plain = {call.id for call in calls if isinstance(call, ast.Name)}
                of_click = {call.attr for call in calls if isinstance(call, ast.Attribute) and _is_click(call.value)}
                if (plain | of_click) & PRINTS:
                    printing.add((path.relative_to(folder).as_posix(), function.name))
    assert printing - {("verify.py", "verify")} == set(BEFORE_THE_RESULT)


def _is_click(node: ast.expr) -> bool:
    return isinstance(node, ast.Name) and node.id == "click"


def test_a_person_sees_the_view_then_the_complaint_and_gets_its_exit_code() -> None:
    done = told(FOUND, as_json=False)
    lines = [line.split() for line in done.stdout.splitlines()]
    assert done.exit_code == Exit.TIMEOUT
    assert done.stderr == "decanter: T is hot\n"
    assert lines[0] == ["as", "it", "stands"] and lines[1] == ["in", "red"]
    assert ["tag", "value", "reason", "absent"] in lines and ["T", "1.5"] in lines  # None and absent cells are empty
    assert ["1", "yes"] in lines


def test_a_program_gets_one_object_that_says_whether_all_is_in_order() -> None:
    bad, good = told(FOUND, as_json=True), told(CommandResult({"seen": 1}), as_json=True)
    assert json.loads(bad.stdout) == {"ok": False, **FOUND.data} and bad.exit_code == Exit.TIMEOUT
    assert json.loads(good.stdout) == {"ok": True, "seen": 1} and good.exit_code == Exit.OK and not good.stderr


@pytest.mark.parametrize("code", [Exit.CHECK_FAILED, Exit.TIMEOUT])
def test_a_result_without_a_complaint_is_in_order_whatever_code_would_go_with_one(code: Exit) -> None:
    assert CommandResult({}, "", code).code == Exit.OK
    assert CommandResult({}, "it is not there", code).code == code


def test_of_steps_the_first_that_failed_is_the_complaint() -> None:
    steps = [ok("disk", "room"), warning("clock", "free"), failed("bus", "down", OSError("x")), failed("map", "bad")]
    result = result_of(steps, heard=3)
    assert (result.complaint, result.code) == ("down", failed("bus", "down", OSError("x")).code)
    assert result.data["heard"] == 3 and [step["state"] for step in result.data["steps"]] == [
        *("ok", "warning", "failed", "failed")
    ]
    assert len(list(step_lines(result.data))) == len(steps)
    assert result_of(steps[:2]).code == Exit.OK
