"""What a command says that it took is its own, and not that of the process which started it."""

import subprocess
import sys
from pathlib import Path

import numpy as np

from gateway.lab.resource_usage import peak_megabytes

SAYS = "from gateway.lab.resource_usage import peak_megabytes; print(peak_megabytes())"


def test_a_child_does_not_count_the_memory_of_the_process_that_started_it() -> None:
    held = np.ones(50_000_000)  # 400 MB
    own = float(subprocess.run([sys.executable, "-c", SAYS], capture_output=True, text=True, check=True).stdout)
    assert held.size and 5.0 < own < 200.0


def test_memory_is_told_in_megabytes_without_linux_too(tmp_path: Path) -> None:
    status = tmp_path / "status"
    status.write_text("Name:\tpython\nVmHWM:\t  500000 kB\nVmRSS:\t  4 kB\n", encoding="utf-8")
    assert peak_megabytes(status) == 512.0
    assert peak_megabytes(tmp_path / "none") > 5.0
