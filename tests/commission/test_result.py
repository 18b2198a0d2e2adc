"""Every command tells what it found in one way: data with a complaint, and a view of lines and tables."""

import ast
import json
from collections.abc import Iterator, Mapping
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from gateway.commission.session import conclude_steps, failed_step, ok, step_lines, warning
from gateway.console import CommandResult, Line, Part, Rows, conclude
from gateway.entry import Exit
from tests.plc.bench import ROOT

PRINTS = {"echo", "secho", "print", "table", "print_json", "echo_via_pager"}
ROOMS = ("commission", "lab", "cli", "demo")
BESIDE_THE_RESULT = {
    ("commission/verify.py", "tell"): "the answer to a question, on standard error",
    ("commission/watch.py", "_lines"): "each change as it comes",
    ("commission/writeback/arm.py", "disarm"): "a plant file that cannot be used, on standard error",
    ("commission/served.py", "served"): "the table as CSV, for another program",
    ("lab/gap/diagnose.py", "diagnose"): "that traces overlap, on standard error",
    ("lab/ingestion/ingest.py", "_tell"): "each file as it comes",
    ("lab/regression/standard.py", "load_models"): "a model that cannot be read, on standard error",
    ("lab/traces/load.py", "load_with_report"): "what of the files was not read, on standard error",
    ("lab/traces/load.py", "channel_warnings"): "what the traces do not show, on standard error",
    ("lab/traces/map.py", "ask_map"): "questions and their answers, on standard error",
    ("cli/keep/configurations.py", "diff"): "the difference as it is, for another program",
    ("cli/plant/accounts.py", "add"): "a sentence of a command without --json",
    ("cli/plant/accounts.py", "password"): "a sentence of a command without --json",
    ("cli/plant/accounts.py", "remove"): "a sentence of a command without --json",
    ("cli/plant/plant_file.py", "control_socket"): "a plant file that cannot be used, on standard error",
    ("cli/plant/run.py", "_say"): "each change as it comes",
    ("cli/setup/certificates.py", "certificates"): "sentences of a command without --json",
    ("cli/setup/completion.py", "completion"): "a script for a shell",
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
    folder, printing = ROOT / "gateway", set()
    for path in sorted(path for room in ROOMS for path in (folder / room).rglob("*.py")):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
                calls = [node.func for node in ast.walk(function) if isinstance(node, ast.Call)]
                plain = {call.id for call in calls if isinstance(call, ast.Name)}
                of_click = {call.attr for call in calls if isinstance(call, ast.Attribute) and _is_click(call.value)}
                if (plain | of_click) & PRINTS:
                    printing.add((path.relative_to(folder).as_posix(), function.name))
    assert printing - {("commission/verify.py", "verify")} == set(BESIDE_THE_RESULT)


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


def test_what_is_not_in_order_may_be_said_by_what_is_shown_alone() -> None:
    shown = told(CommandResult({"rows": []}, failing=Exit.NOT_ARMED, ok=False), as_json=False)
    assert shown.exit_code == Exit.NOT_ARMED and not shown.stderr and "as it stands" in shown.stdout
    plain = told(CommandResult({}, ok=False), as_json=True)
    assert json.loads(plain.stdout) == {"ok": False} and plain.exit_code == Exit.CHECK_FAILED


def test_what_stands_aside_is_on_standard_error() -> None:
    done = CliRunner().invoke(
        click.command()(lambda: conclude(CommandResult({}), lambda _: [Line("aside", aside=True)], as_json=False)), []
    )
    assert (done.stdout, done.stderr) == ("", "aside\n")


def test_of_steps_the_first_that_failed_is_the_complaint() -> None:
    steps = [
        ok("disk", "room"),
        warning("clock", "free"),
        failed_step("bus", "down", OSError("x")),
        failed_step("map", "bad"),
    ]
    result = conclude_steps(steps, heard=3)
    assert (result.complaint, result.code) == ("down", failed_step("bus", "down", OSError("x")).code)
    assert result.data["heard"] == 3 and [step["state"] for step in result.data["steps"]] == [
        *("ok", "warning", "failed", "failed")
    ]
    assert len(list(step_lines(result.data))) == len(steps)
    assert conclude_steps(steps[:2]).code == Exit.OK
