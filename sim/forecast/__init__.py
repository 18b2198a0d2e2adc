"""What the temperature may do next, and what keeps that honest."""

from sim.forecast.band_widening import widening_factors
from sim.forecast.calibration import (
    Z90,
    Calibration,
    Horizon,
    PendingForecast,
    calibrate,
    factors,
    issue,
    recent_coverage,
    reshape,
    settle,
)
from sim.forecast.ensemble import (
    DENSE_LEVELS,
    Losses,
    Pool,
    PoolEvidence,
    issue_pool,
    member_weights,
    mixture,
    settle_pool,
    thin_levels,
    weights_by_horizon,
)
from sim.forecast.fan import FAN_LEVELS, Forecast, fans, forecast
from sim.forecast.leaps import observe_leap
from sim.forecast.local_trend import LocalOutlook, LocalTrend, walk_outlook
from sim.forecast.past_readings import HeldAgainstPast, LikeMoments
from sim.forecast.review import FORECASTS, ONE_STEP, Review, follow, follow_forecasts, review_errors, share, standardise
