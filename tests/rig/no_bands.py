"""Learning without bands, for which a model is fitted two or three times more, where nothing is asked of them."""

import pytest

from sim.lab.learning.bins import learn as bins
from sim.lab.learning.calibrate import HeldOutForecasts
from sim.lab.learning.lsha import learn as lsha


def without_bands(patch: pytest.MonkeyPatch) -> None:
    """What this process learns from now on, by either method, has no held-out forecasts and so no calibration."""
    patch.setattr(bins, "_held_out_forecasts", lambda *_, **__: HeldOutForecasts([], 0))
    patch.setattr(lsha, "bands", lambda *_, **__: HeldOutForecasts([], 0))
