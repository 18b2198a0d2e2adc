"""Software PLCs that run for the tests of a file: a process costs more than most of what is asked of it.

Not for all files: one that nobody asks anything computes its cycles until the session ends.
"""

from collections.abc import Iterator

import pytest

from tests.plc.bench import Process, ramp, running, wait_until


@pytest.fixture(scope="module")
def _plain() -> Iterator[Process]:
    with running() as process:
        yield process


@pytest.fixture(scope="module")
def _on_the_ramp(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Process]:
    with running("--trace", ramp(tmp_path_factory.mktemp("ramp")), "--hold") as process:
        yield process


@pytest.fixture
def plain_plc(_plain: Process) -> Iterator[Process]:
    """A PLC without a trace, for whoever leaves no block in it; faults are cleared behind the test."""
    yield _plain
    restored(_plain)


@pytest.fixture
def ramp_plc(_on_the_ramp: Process) -> Iterator[Process]:
    """A PLC that holds the ramp at its first row, for whoever leaves no block in it; it is put back behind the test."""
    yield _on_the_ramp
    _on_the_ramp.order("release")
    _on_the_ramp.order("seek", position=0.0)
    restored(_on_the_ramp)


def restored(plc: Process) -> None:
    """No fault is left, no client, and a cycle has passed since."""
    plc.order("clear")
    wait_until(lambda: (status := plc.order("status"))["faults"] == [] and status["connections"] == 0)
    heartbeat = plc.order("status")["heartbeat"]
    wait_until(lambda: plc.order("status")["heartbeat"] != heartbeat)
