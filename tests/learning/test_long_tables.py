"""What `model learn` shows of tables that nobody reads: their first rows and how many there are.

That a learning goes through this is seen where one is shown anyway (`tests/traces/test_cells_add_up.py`).
"""

from gateway.console import Rows
from gateway.lab.learning import learn


def test_a_table_is_cut_beyond_its_limit_and_nothing_else_is() -> None:
    long, longer = (Rows("fits", ["place"], [[place] for place in range(count)]) for count in (40, 41))
    assert learn._shortened(long) == long
    assert learn._shortened("a sentence") == "a sentence"
    cut = learn._shortened(longer)
    assert cut == Rows("fits (the first 40 of 41 rows; --json has all)", ["place"], [[place] for place in range(40)])
