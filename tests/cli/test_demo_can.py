"""The demonstration over raw CAN: the same main job, the same judge, and no process left behind, the hub included."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from gateway.demo.can_bus import LONGEST_PATH, hub_path
from tests.cli.test_demo import GATEWAY, PATIENCE_S, performed, sane


@pytest.mark.slow
def test_the_demo_runs_the_main_job_over_can_frames(traces: Path, tmp_path: Path) -> None:
    data = performed(tmp_path / "out", "--link", "can", "--trace", traces / "cd17.csv", "--seconds", 6)
    sane(data)
    assert data["link"] == "can"
    assert not hub_path(tmp_path / "out").exists()


@pytest.mark.slow
def test_a_demo_over_can_that_is_killed_leaves_no_process_behind(traces: Path, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    command = [*GATEWAY, "demo", "--json", "--link", "can", "--trace", traces / "cd17.csv", "--seconds", "60"]
    with subprocess.Popen([*map(str, command), "--out", str(folder)], stdout=subprocess.DEVNULL) as demo:
        end = time.monotonic() + PATIENCE_S
        while not (folder / "status.json").exists():
            assert time.monotonic() < end
            time.sleep(0.05)
        children = _children(demo.pid)
        assert len(children) == 3
        demo.send_signal(signal.SIGKILL)
    while any(Path(f"/proc/{child}/cmdline").exists() and not _is_zombie(child) for child in children):
        assert time.monotonic() < end
        time.sleep(0.05)


def test_the_hubs_socket_has_a_path_that_a_socket_can_have(tmp_path: Path) -> None:
    assert hub_path(tmp_path) == tmp_path / "can.hub"
    far = tmp_path / ("x" * 120)
    assert len(os.fsencode(hub_path(far))) <= LONGEST_PATH
    assert hub_path(far) == hub_path(far) != hub_path(far / "y")


def _children(pid: int) -> list[int]:
    task = Path(f"/proc/{pid}/task/{pid}/children")
    return [int(child) for child in task.read_text(encoding="ascii").split()]


def _is_zombie(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True
