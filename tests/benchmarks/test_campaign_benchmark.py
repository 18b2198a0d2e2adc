"""The benchmarks of campaign and semantics run in a tiny setting; whether they are fast is not asserted."""

import json
import subprocess
import sys

import pytest

from benchmarks.processes import ROOT


@pytest.mark.slow
def test_the_campaigns_benchmark_prints_its_figures_as_json() -> None:
    command = [sys.executable, "-m", "benchmarks.campaign", "--json", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    figures = json.loads(done.stdout)["figures"]
    assert {"s", "MB"} == {one["unit"] for one in figures} and all(one["value"] > 0 for one in figures)
    assert sum("16 jobs" in one["name"] for one in figures) == 4


@pytest.mark.slow
def test_the_semantics_benchmark_holds_each_trace_out_once_and_gives_the_gain_with_its_interval() -> None:
    command = [sys.executable, "-m", "benchmarks.semantics", "--json", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    figures = {one["name"]: one for one in json.loads(done.stdout)["figures"]}
    carried = figures["cd1..cd17, held out: MAE, carried"]
    (gain,) = (one for name, one in figures.items() if "gain in MAE, 4 traces" in name)
    assert gain["value"] == pytest.approx(carried["other"] - carried["value"])
    assert figures["cd1..cd17, held out: carried is better (MAE)"]["other"] == 4
