"""What holds for all tests: one thread for matrices, and which tests start processes of their own."""

import os
from pathlib import Path

import pytest

# Before numpy is imported anywhere: matrices as small as a model's take longer with two threads than with one, and the
# processes that tests start inherit it. `gateway.console.threads` does the same for the product's commands.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

INTEGRATION = Path(__file__).parent / "integration"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Everything in tests/integration runs real processes; elsewhere a module or a test says so by its mark."""
    for item in items:
        if INTEGRATION in item.path.parents:
            item.add_marker(pytest.mark.process)
