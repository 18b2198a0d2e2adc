"""The engine is found, run with a limit, and compared; here an executable of our own stands in for it."""

import os
import stat
import sys
import time
from dataclasses import replace
from math import isfinite
from pathlib import Path

import numpy as np
import pytest

from sim.lab.uppaal.comparison import ComparisonRow, compare, native_runs
from sim.lab.uppaal.model_export import Exported, export, write
from sim.lab.uppaal.output import Output, VerifytaAnswer, parse_output
from sim.lab.uppaal.verifyta import VARIABLE, EngineError, find_engine, run_engine
from tests.uppaal.support import courses, replayed, two_locations

MODEL, TRACE = two_locations("exponential"), replayed()


def stand_in(folder: Path, body: str, name: str = "verifyta") -> Path:
    """An executable Python script."""
    path = folder / name
    path.write_text(f"#!{sys.executable}\nimport sys, time, os, subprocess\n{body}\n", encoding="utf-8")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_the_engine_is_found_by_option_then_environment_then_path(tmp_path: Path) -> None:
    by_option, by_variable, by_path = (tmp_path / name for name in "abc")
    for folder in (by_option, by_variable, by_path):
        folder.mkdir()
        stand_in(folder, "")
    environment = {VARIABLE: str(by_variable / "verifyta"), "PATH": str(by_path)}
    assert find_engine(str(by_option / "verifyta"), environment) == by_option / "verifyta"
    assert find_engine(str(by_option), environment) == by_option / "verifyta"
    assert find_engine(None, environment) == by_variable / "verifyta"
    assert find_engine(None, {"PATH": str(by_path)}) == by_path / "verifyta"


def test_an_engine_that_is_not_there_is_told_with_what_was_looked_at(tmp_path: Path) -> None:
    with pytest.raises(EngineError, match=f"--verifyta is not given, {VARIABLE} is not set and PATH has none"):
        find_engine(None, {"PATH": str(tmp_path)})
    with pytest.raises(EngineError, match="is not there"):
        find_engine(str(tmp_path / "nothing"), {})
    (tmp_path / "text").write_text("", encoding="utf-8")
    with pytest.raises(EngineError, match="not an executable"):
        find_engine(str(tmp_path / "text"), {})


def test_the_engine_gets_the_model_and_the_query_file(tmp_path: Path) -> None:
    engine = stand_in(
        tmp_path,
        "model, queries = sys.argv[-2:]\n"
        "assert os.path.exists(model) and os.path.exists(queries)\n"
        "print('Verifying formula 1 at', queries + ':2')\n"
        "print('-- Formula is', 'satisfied.' if sys.argv[1:-2] == ['-s', '-q', '-r', '3'] else 'NOT satisfied.')",
    )
    written = write(tmp_path, export(MODEL, TRACE))
    ran = run_engine(engine, written[2], written[3], wanted=1, timeout=60, seed=3)
    assert ran.failure == "" and ran.output.answers[0].satisfied is True


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("print('no such thing')", "answered 0 of 1 queries and ended with code 0; it printed no such thing"),
        ("print('a.xml:3: [error] Unknown identifier: m.', file=sys.stderr); sys.exit(1)", "refuses the model"),
        ("print('Verifying formula 1 at q:1'); sys.stdout.flush(); os.abort()", "answered 0 of 1 queries and ended"),
        ("os.write(1, bytes(range(256)) * 50)", "answered 0 of 1"),
        ("print('License key is not set.', file=sys.stderr); sys.exit(2)", "no valid licence"),
    ],
)
def test_an_engine_that_fails_is_told_in_a_sentence(tmp_path: Path, body: str, words: str) -> None:
    ran = run_engine(stand_in(tmp_path, body), tmp_path / "a.xml", tmp_path / "a.q", wanted=1, timeout=60)
    assert words in ran.failure


def test_an_engine_that_hangs_is_stopped_with_its_children_and_its_answers_kept(tmp_path: Path) -> None:
    body = (
        "child = subprocess.Popen(['sleep', '300'])\n"
        f"open({str(tmp_path / 'pid')!r}, 'w').write(str(child.pid))\n"
        "print('Verifying formula 1 at q:1\\n-- Formula is satisfied.', flush=True)\n"
        "time.sleep(300)"
    )
    ran = run_engine(stand_in(tmp_path, body), tmp_path / "a.xml", tmp_path / "a.q", wanted=2, timeout=3)
    assert ran.failure == "verifyta was stopped after 3 s; give more with --timeout"
    assert ran.output.answers[0].satisfied is True
    child = int((tmp_path / "pid").read_text(encoding="utf-8"))
    deadline = time.monotonic() + 60.0  # a process that was killed may still be seen for a moment
    while running(child) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not running(child)


def running(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").split()[2] not in "ZX"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_script_without_an_interpreter_is_told(tmp_path: Path) -> None:
    engine = tmp_path / "verifyta"
    engine.write_text("#!/no/such/interpreter\n", encoding="utf-8")
    engine.chmod(0o755)
    with pytest.raises(EngineError, match="cannot be started"):
        run_engine(engine, tmp_path / "a.xml", tmp_path / "a.q", 1, 5.0)


def as_printed(exported: Exported, shift: float = 0.0, runs: int = 2000) -> Output:
    """What UPPAAL would print of the main model, made by the tests' own interpreter of the exported text."""
    rng = np.random.default_rng(11)
    network, seen = courses(
        exported.main.xml, exported.replay.time_bound, lambda _, mean, sigma: rng.normal(mean, sigma, runs), most=1.0
    )
    values = np.array([np.broadcast_to(value, runs) for value in seen.values()]) + shift
    lines = []
    for number, question in enumerate(exported.main.questions, 1):
        lines += [f"Verifying formula {number} at q.q:{number}", "-- Formula is satisfied."]
        if question.formula.startswith("simulate"):
            lines.append("m_1.Temp:")
            for run in range(10):
                points = " ".join(f"({time},{x})" for time, x in zip(seen, values[:, run], strict=True))
                lines.append(f"[{run}]: {points}")
        elif question.formula.startswith("Pr") and "m_1.Temp >=" in question.formula:
            level = float(question.formula.rstrip(")").rsplit(" ", 1)[1])
            hits = int((values.max(axis=0) >= level).sum())
            low, high = max(0.0, hits / runs - 0.025), min(1.0, hits / runs + 0.025)
            lines.append(f"({hits}/{runs} runs) Pr(<> ...) in [{low},{high}] (95% CI)")
        elif "max: m_1.Temp" in question.formula or "min: m_1.Temp" in question.formula:
            extreme = values.max(axis=0) if "max" in question.formula else values.min(axis=0)
            half = 1.96 * extreme.std() / np.sqrt(runs)
            lines.append(f"({runs} runs) E(max) = {extreme.mean()} ± {half} (95% CI)")
    assert network.by_name["m_1"].own["taken"] == len(exported.replay.times)
    return parse_output("\n".join(lines))


def compared(shift: float) -> list[ComparisonRow]:
    exported = export(MODEL, TRACE)
    native = native_runs(MODEL, TRACE, exported.replay, "resync", 1, np.random.default_rng(0))
    answers = as_printed(exported, shift).answers
    assert len(answers) == len(exported.main.questions)
    return compare(exported.main.questions, answers, native, MODEL)


def test_the_interpreted_export_and_the_native_engine_agree_in_every_row_that_both_have() -> None:
    rows = compared(0.0)
    judged = [row for row in rows if row.agree is not None]
    assert len(judged) >= 7
    assert [row.quantity for row in judged if not row.agree] == []
    assert all(isfinite(row.difference) for row in judged)


def test_a_model_that_is_not_ours_is_seen_in_the_comparison() -> None:
    judged = [row for row in compared(5.0) if row.agree is not None]
    assert sum(row.agree is False for row in judged) >= 6


def test_answers_without_figures_make_rows_without_a_judgement() -> None:
    exported = export(MODEL, TRACE)
    native = native_runs(MODEL, TRACE, exported.replay, "resync", 1, np.random.default_rng(0))
    empty = [VerifytaAnswer(number, "q") for number in range(1, 4)]
    rows = compare(exported.main.questions, empty, native, MODEL)
    assert [row.agree for row in rows] == [None, None, None]
    assert all(row.note for row in rows)


def test_an_expectation_without_an_interval_takes_its_own_from_the_histogram() -> None:
    exported = export(MODEL, TRACE)
    native = native_runs(MODEL, TRACE, exported.replay, "resync", 1, np.random.default_rng(0))
    text = (
        "Verifying formula 1 at q\n-- Formula is satisfied.\n(100 runs) E(max) = 34.5\n"
        "Values in [32,38] mean=34.5 steps=2: 30 40 30\n"
    )
    question = next(one for one in exported.main.questions if "max: m_1.Temp" in one.formula)
    row = compare([question], parse_output(text).answers, native, MODEL)[0]
    half = row.uppaal_interval[1] - 34.5
    assert half == pytest.approx(1.984 * (0.6 * 4.0 * 100 / 99) ** 0.5 / 10, rel=1e-3)


def test_the_compatibility_verdict_is_compared_with_ours() -> None:
    exported = export(MODEL, TRACE)
    native = native_runs(MODEL, TRACE, exported.replay, "resync", 1, np.random.default_rng(0))
    for satisfied in (True, False):
        row = compare(exported.minimal.questions, [VerifytaAnswer(1, "q", satisfied)], native, MODEL)[0]
        assert row.agree is satisfied
    refused = replace(native, replay=replace(native.replay, accepted=False))
    assert compare(exported.minimal.questions, [VerifytaAnswer(1, "q", False)], refused, MODEL)[0].agree is True


def test_the_stand_in_is_not_on_this_machine_s_path() -> None:
    """Nothing here may depend on an installed UPPAAL."""
    assert VARIABLE not in os.environ
