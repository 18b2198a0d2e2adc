"""How many threads the arithmetic takes: one a process, for matrices as small as a model's."""

import os

VARIABLE = "OPENBLAS_NUM_THREADS"


def one_thread() -> None:
    """Keeps numpy's linear algebra to one thread, unless the environment says otherwise; before numpy is imported.

    On two cores that do other work as well, two threads wait for one another: learning took seven times the CPU time.
    """
    os.environ.setdefault(VARIABLE, "1")
