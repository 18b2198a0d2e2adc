"""The engineer's hour in short: an unknown PLC from `probe` to a sealed report and blocks that the PLC uses."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.commissioning import ANALOGUE, FLAGS, Walk, WalkError, made
from gateway.cli.main import main
from gateway.commission.session.records import find_break, read_records
from gateway.store.audit import read, verify


class InProcessWalk(Walk):
    """A walk whose commands run in this process, which has their libraries loaded already.

    Processes of their own are the first command, the one that asks a person, and the gateway itself; the benchmark of
    the walk starts one for each.
    """

    def decanter(self, *arguments: object, expect: int = 0, answers: Callable[[str], str] | None = None) -> str:
        if answers is not None or not self.commands:
            return super().decanter(*arguments, expect=expect, answers=answers)
        self.commands += 1
        result = CliRunner().invoke(main, [str(argument) for argument in arguments])
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        if result.exit_code != expect:
            raise WalkError(f"decanter {arguments}: exit code {result.exit_code} instead of {expect}:\n{result.output}")
        return result.output


@pytest.mark.timeout(1200)
def test_an_unknown_plc_is_commissioned_by_commands_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("DECANTER_BY", "M. Rossi")
    walked, _ = made(tmp_path, soak_s=2.0, conformance=False, kind=InProcessWalk)
    records = read_records(tmp_path / "out/commissioning.jsonl")
    assert find_break(tmp_path / "out/commissioning.jsonl") is None
    failed = [(record.command, record.reason) for record in records if record.code not in (0, 6)]
    assert failed == []
    proved = next(record for record in reversed(records) if record.command == "verify").result
    assert proved["proved"] == len(FLAGS) + len(ANALOGUE)
    report = json.loads((tmp_path / "out/acceptance/report.json").read_text(encoding="utf-8"))
    assert report["verdict"] in ("passed", "passed with open points")
    assert verify(tmp_path / "out/audit.sqlite").problem == ""
    kinds = [row.entry.kind for row in read(tmp_path / "out/audit.sqlite", ())]
    assert {"armed", "disarmed", "write", "acceptance report"} <= set(kinds)
    writes = [json.loads(line) for line in walked.unknown.recording.read_text(encoding="utf-8").splitlines()]
    block = range(401, 401 + 16)
    functions = {one["function"] for one in writes if one["k"] == "request" and one["function"] > 4}
    assert functions <= {16, 17, 43}, "blocks, and who the device is"
    touched = [one for one in writes if one["k"] == "request" and one["function"] == 16]
    assert touched and all(one["address"] in block and one["address"] + one["count"] <= block.stop for one in touched)
