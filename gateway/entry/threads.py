"""How many threads the arithmetic takes: one a process, for matrices as small as a model's."""

import os

ALL_LIBRARIES = "OMP_NUM_THREADS"
"""The number of threads that the libraries of linear algebra take where they are told none of their own."""
VARIABLES = (ALL_LIBRARIES, "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread() -> None:
    """Keeps linear algebra to one thread, here and in the processes started from here; before numpy is imported.

    What the environment says already is kept. On two cores two threads wait for one another: seven times the processor
    time of learning.
    """
    wanted = os.environ.get(ALL_LIBRARIES, "1")
    for variable in VARIABLES:
        os.environ.setdefault(variable, wanted)
