"""The benchmarks of queries and statistical checking run in a tiny setting; whether they are fast is not asserted."""

import json
import subprocess
import sys
from typing import Any

import pytest

from benchmarks.processes import ROOT
from benchmarks.smc import RARE, parameter_sets


def said(name: str) -> dict[str, dict[str, Any]]:
    command = [sys.executable, "-m", f"benchmarks.{name}", "--json", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr
    return {figure["name"]: figure for figure in json.loads(done.stdout)["figures"]}


@pytest.mark.benchmark
def test_the_benchmark_of_checking_gives_agreement_and_speeds() -> None:
    figures = said("smc")
    held = figures["first passage: 95 % intervals that hold it"]
    assert held["value"] >= held["other"] - 1 >= 3
    assert figures[f"first passage below {RARE:g}: 95 % intervals that hold it"]["other"] >= 1
    assert all(figure["value"] > 0 for name, figure in figures.items() if "steps a run" in name)
    for name, figure in figures.items():
        if "share of successes" in name:
            assert figure["value"] == pytest.approx(figure["other"], abs=0.02)


@pytest.mark.benchmark
def test_the_benchmark_of_queries_gives_coverage_and_costs() -> None:
    figures = said("queries")
    assert figures["sequential Clopper-Pearson: coverage at p = 0.1"]["value"] == pytest.approx(0.927, abs=0.002)
    assert figures["anytime-valid: coverage at p = 0.1"]["value"] >= 0.95
    assert figures["pairs to tell 0.52 from 0.5, common numbers"]["ratio"] < 0.2


def test_the_parameter_sets_are_many_and_different() -> None:
    cases = parameter_sets()
    assert len({(case.name, case.limit) for case in cases}) == len(cases) >= 40
    assert {one.flow.kind for case in cases for one in case.stretches} == {
        "linear", "constant", "exponential", "logarithmic"
    }  # fmt: skip
