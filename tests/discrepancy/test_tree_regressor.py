"""The trees of a diagnosis: what they load, and what they leave alone."""

import os
import subprocess
import sys

PROGRAM = """
import sys
from threadpoolctl import threadpool_info
from sim.lab.tree_regressor import one_thread, tree_regressor
with one_thread():
    tree_regressor(max_iter=1).fit([[0.0], [1.0]], [0.0, 1.0])
    threads = [each["num_threads"] for each in threadpool_info() if each["user_api"] == "openmp"]
    assert threads and set(threads) == {1}, threads
assert "sklearn" in sys.modules and "pandas" not in sys.modules and "pyarrow" not in sys.modules
import pandas
assert pandas.DataFrame is not None
"""


def test_trees_load_no_pandas_for_whoever_asks_later_and_the_first_fit_of_a_process_takes_one_thread() -> None:
    """The limit was set before what it should have limited was loaded: two threads waited for one another."""
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, env={**os.environ, "OMP_NUM_THREADS": "2"})
