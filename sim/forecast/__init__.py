"""What the temperature may do next, and what keeps that honest."""

from sim.forecast.band_widening import factors_at
from sim.forecast.calibration import (
    Z90,
    Calibration,
    Horizon,
    PendingForecast,
    calibrate,
    factors,
    issue,
    recent_coverage,
    settle,
)
from sim.forecast.ensemble import (
    DENSE,
    Losses,
    Pool,
    PoolEvidence,
    issue_pool,
    mixture,
    settle_pool,
    thinned,
    weighted,
    weights_by_horizon,
)
from sim.forecast.fan import LEVELS, Forecast, fans, forecast
from sim.forecast.review import FORECASTS, ONE_STEP, Review, beyond, follow, follow_forecasts, share, standardised
