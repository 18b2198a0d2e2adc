"""What holds for all tests: one thread for matrices, and the inner loop that starts no processes."""

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

# Before numpy is imported anywhere: matrices as small as a model's take longer with two threads than with one, and the
# processes that tests start inherit it. `gateway.entry.threads` does the same for the product's commands.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

# A shell that starts a command in the background lets it ignore Control-C, and its children inherit that; the tests of
# Control-C speak of a command in the foreground.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

INTEGRATION = Path(__file__).parent / "integration"


def pytest_addoption(parser: pytest.Parser) -> None:
    """`--without-processes`, the inner loop of `make check`."""
    parser.addoption(
        "--without-processes", action="store_true", help="Skip whatever starts a process, and what is slow."
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Files with slow tests come first, so that no worker begins one of them when the others are nearly done.

    Without processes, what runs for more than five seconds is left out, before its fixtures begin.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow") or INTEGRATION in item.path.parents}
    items.sort(key=lambda item: item.path not in slow)
    if config.getoption("--without-processes"):
        left_out = {item for item in items if item.get_closest_marker("slow") or INTEGRATION in item.path.parents}
        config.hook.pytest_deselected(items=list(left_out))
        items[:] = [item for item in items if item not in left_out]


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
