"""The campaign's benchmark runs in a tiny setting and gives its figures; whether it is fast is not asserted."""

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
