"""The trees of a diagnosis: what they load, and what they leave alone."""

import subprocess
import sys

PROGRAM = """
import sys
from sim.lab.tree_regressor import tree_regressor
tree_regressor(max_iter=1).fit([[0.0], [1.0]], [0.0, 1.0])
assert "sklearn" in sys.modules and "pandas" not in sys.modules and "pyarrow" not in sys.modules
import pandas
assert pandas.DataFrame is not None
"""


def test_trees_load_no_pandas_and_it_is_there_for_whoever_asks_later() -> None:
    subprocess.run([sys.executable, "-c", PROGRAM], check=True)
