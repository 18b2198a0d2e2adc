"""What holds for all tests: one thread for matrices, who runs which file when, and the inner loop without processes."""

import gc
import json
import os
import re
import signal
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits
from xdist.scheduler import LoadFileScheduling  # type: ignore[import-untyped]

from tests.rig.patient_loop import PatientLoop

# Collecting makes what stays and hardly any garbage; `pytest_collection_finish` turns the collector on again.
gc.disable()

# The tests start some hundred processes, and each of pytest's own loads all tests: where bytecode may not be kept, as
# in many containers, every one of them would compile our modules anew.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# As `decanter` has it for its own processes (decanter_gateway/start.py): tests start modules, which would look through
# all installed packages for plug-ins of pydantic each time.
os.environ["PYDANTIC_DISABLE_PLUGINS"] = "__all__"

# Tests look for words, not for where a table folds them; the tests of tables name their own width.
os.environ["COLUMNS"] = "240"

# A shell that starts a command in the background lets it ignore Control-C, and its children inherit that; the tests of
# Control-C speak of a command in the foreground.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# How long an example takes says what else the machine does: the worker with a low priority may hardly get any of it.
settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")

TESTS = Path(__file__).parent
INTEGRATION = TESTS / "integration"
DURATIONS = TESTS / "durations.json"
"""Seconds of every test that took LONG or more, with its fixtures, when `make durations` measured it last."""
LONG = 0.3
COMPUTING = ("checking", "discrepancy", "discrepancy_report", "effects", "learning", "sha", "uppaal")
"""Rooms whose tests only compute: nothing in them is early or late."""
LOW_PRIORITY = 10
DISK_S = 60.0


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--without-processes`, the inner loop of `make check`; `--write-durations`, what `make durations` does."""
    parser.addoption("--without-processes", action="store_true", help="Skip whatever starts a process or takes long.")
    parser.addoption("--spare", action="store_true", help="The last worker computes with what the others leave idle.")
    parser.addoption("--write-durations", action="store_true", help=f"Measure anew what {DURATIONS.name} holds.")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """The files that take longest come first, so that no worker begins one of them when the others are nearly done.

    Without processes, what takes long is left out before its fixtures begin. A test that was not measured yet is short.
    """
    durations: dict[str, float] = json.loads(DURATIONS.read_text(encoding="utf-8"))
    by_file: defaultdict[Path, float] = defaultdict(float)
    for item in items:
        by_file[item.path] += durations.get(item.nodeid, 0.0)
    items.sort(key=lambda item: -by_file[item.path])
    if config.getoption("--without-processes"):
        left_out = {item for item in items if item.nodeid in durations or INTEGRATION in item.path.parents}
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]


def is_spare(workerinput: dict[str, Any]) -> bool:
    """Whether it is the last of pytest's processes, which `--spare` is about."""
    return bool(workerinput["workerid"] == f"gw{workerinput['workercount'] - 1}")


class SpareScheduling(LoadFileScheduling):  # type: ignore[misc]
    """Files that only compute go to the last worker, at a low priority; to the others when there is nothing else left.

    The others wait for time to pass, often all at once. Who computes meanwhile must not make them late.
    """

    @staticmethod
    def computes(file: str) -> bool:
        return file.startswith(tuple(f"{TESTS.name}/{room}/" for room in COMPUTING))

    def _assign_work_unit(self, node: Any) -> None:
        spare = is_spare(node.workerinput)
        first = next((file for file in self.workqueue if self.computes(file) == spare), None)
        if first is not None:
            self.workqueue.move_to_end(first, last=False)
        super()._assign_work_unit(node)

    def _reschedule(self, node: Any) -> None:
        if is_spare(node.workerinput) and not any(map(self.computes, self.workqueue)):
            node.shutdown()  # after what it has already
        else:
            super()._reschedule(node)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> SpareScheduling | None:
    """With `--spare` in the place of xdist's own distribution by files."""
    return SpareScheduling(config, log) if config.getoption("--spare") else None


def pytest_collection_finish(session: pytest.Session) -> None:
    """All modules and tests stay until the end: the garbage collector need not walk through them time and again.

    Without this that walk is a tenth of the processor time of all tests. It also comes less often, since Hypothesis is
    called at the beginning and the end of each of its walks.
    """
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    gc.enable()
    # Matrices as small as a model's take longer with two threads than with one. Only in this process, and by no
    # variable: a command that a test starts has to see to that itself.
    threadpool_limits(1)
    config = session.config
    if config.getoption("--spare") and hasattr(config, "workerinput") and is_spare(config.workerinput):
        os.nice(LOW_PRIORITY)  # not before: the others wait for its collection


def pytest_asyncio_loop_factories() -> dict[str, type[PatientLoop]]:
    """No deadline in a test's own loop passes while the machine does something else."""
    return {"patient": PatientLoop}


class Durations:
    """Adds up what the phases of each test took, wherever it ran, and writes DURATIONS when all have."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.seconds: defaultdict[str, float] = defaultdict(float)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        self.seconds[report.nodeid] += report.duration

    def pytest_sessionfinish(self) -> None:
        known = {name: round(seconds, 1) for name, seconds in sorted(self.seconds.items()) if seconds >= LONG}
        if self.config.getoption("--without-processes"):
            # What was left out keeps its figure; what took long now, since its file's fixtures fell to it, joins it.
            known = dict(sorted((json.loads(DURATIONS.read_text(encoding="utf-8")) | known).items()))
        DURATIONS.write_text(json.dumps(known, indent=0) + "\n", encoding="utf-8")


def pytest_configure(config: pytest.Config) -> None:
    """The process that hears of all tests writes the durations; with several workers that is the one without tests."""
    if config.getoption("--write-durations") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations(config))


def untried(config: pytest.Config) -> Counter[str]:
    """Why tests were skipped, and how many for each reason; a file that was skipped whole counts as one."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    reports = [] if reporter is None else reporter.stats.get("skipped", [])
    return Counter(str(report.longrepr[2]).removeprefix("Skipped: ") for report in reports)


def promised(reason: str) -> set[str]:
    """The packages of a reason that CI says to have (`COUNTERPARTS`, .ci/run)."""
    named = re.search(r"apt-get install ([^)]*)", reason)
    return set(named[1].split()) & set(os.environ.get("COUNTERPARTS", "").split()) if named else set()


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A test is not skipped for want of what is there."""
    if not hasattr(session.config, "workerinput") and any(map(promised, untried(session.config))):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """What was not tried on this machine, and how to get it."""
    if not (reasons := untried(config)):
        return
    terminalreporter.section("not tried on this machine")
    for reason, count in reasons.most_common():
        failed = f"{', '.join(promised(reason))} is installed, and was not found: " if promised(reason) else ""
        terminalreporter.write_line(f"{count:5} {failed}{reason}", red=bool(failed))
    terminalreporter.write_line("`make counterparts` (root) installs what Debian has of them")


@pytest.fixture(scope="session", autouse=True)
def _no_processes(request: pytest.FixtureRequest) -> Iterator[None]:
    """Whoever starts a process is skipped at that moment: no list of tests that could be forgotten."""
    if not request.config.getoption("--without-processes"):
        yield
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            subprocess.Popen, "__init__", lambda *_, **__: pytest.skip("starts a process: `make test` runs it")
        )
        yield


@pytest.fixture
def patient_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """A disk that is busy with other things holds no block back where the test is not about that.

    A block is held back whose audit row is not stored in a quarter of a second (a second where a command writes it): on
    such a disk an `fsync` alone takes that long. What is held back then is shown in
    tests/cases/block_before_its_audit_row.
    """
    audit: Any = import_module("gateway.store.audit").Audit  # here: most tests need none of it
    stored = audit.stored

    async def patient(log: Any, entry: Any, timeout: float = DISK_S, undo: Any = None) -> Any:
        return await stored(log, entry, max(timeout, DISK_S), undo)

    monkeypatch.setattr(audit, "stored", patient)
    monkeypatch.setattr("gateway.commission.writeback.block_writer.PERMIT_S", DISK_S)
