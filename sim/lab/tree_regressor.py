"""scikit-learn's boosted trees, without what their import would load besides."""

import sys
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

from threadpoolctl import threadpool_limits

if TYPE_CHECKING:
    from sklearn.ensemble import HistGradientBoostingRegressor

UNUSED = "pandas"
"""scikit-learn imports it where it is installed, to know the missing values of its tables: 60 MB, with pyarrow, for
trees that are given arrays."""


def tree_regressor(**settings: Any) -> "HistGradientBoostingRegressor":
    """A regressor with the settings of `HistGradientBoostingRegressor`."""
    loaded = UNUSED in sys.modules or "sklearn.utils.fixes" in sys.modules
    if not loaded:
        sys.modules[UNUSED] = None  # type: ignore[assignment]  # an import of it is an ImportError, as without it
    try:
        from sklearn.ensemble import HistGradientBoostingRegressor
    finally:
        if not loaded:
            del sys.modules[UNUSED]
    return HistGradientBoostingRegressor(**settings)


def one_thread() -> AbstractContextManager[object]:
    """Within it trees are fitted and asked on one thread: for few rows, threads that wait for one another cost more.

    A limit holds for the libraries that are loaded when it is set, hence the trees are loaded first.
    """
    tree_regressor()
    limit: AbstractContextManager[object] = threadpool_limits(1)
    return limit
