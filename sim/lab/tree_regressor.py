"""scikit-learn's boosted trees, without what their import would load besides."""

import sys
from typing import TYPE_CHECKING, Any

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
