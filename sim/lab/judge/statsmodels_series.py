"""Models of one series by statsmodels (the extra `bench`): exponential smoothing, ARIMA and Theta, chosen by AICc.

Each function takes a series on an even grid and gives what it expects `steps` further on, with its standard deviation.
The only module that imports statsmodels: it is loaded when such a rival is used, never by the room's door.
"""

import warnings
from itertools import product

import numpy as np
import scipy
from statsmodels.tsa.arima.estimators.hannan_rissanen import hannan_rissanen
from statsmodels.tsa.exponential_smoothing.ets import ETSModel, ETSResults
from statsmodels.tsa.statespace.sarimax import SARIMAX
from statsmodels.tsa.stattools import kpss

from sim.sha import Array

MAX_ORDER = 3
"""No more autoregressive or moving-average terms than this."""
SIGNIFICANCE_LEVEL = 0.05


def damped_trend(series: Array, steps: int) -> tuple[Array, Array]:
    """ETS(A,Ad,N), additive damped trend (Gardner & McKenzie 1985), by maximum likelihood."""
    return _ets_ahead(_ets(series, trend=True, damped=True), steps)


def auto_ets(series: Array, steps: int) -> tuple[Array, Array]:
    """The best of ETS without season and with additive errors, by AICc (Hyndman et al. 2002).

    Multiplicative errors and trends are left out: they would depend on where degC has its zero.
    """
    fits = [_ets(series, trend=trend, damped=damped) for trend, damped in ((False, False), (True, False), (True, True))]
    return _ets_ahead(min(fits, key=lambda fit: fit.aicc), steps)


def _ets(series: Array, *, trend: bool, damped: bool) -> ETSResults:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = ETSModel(series, error="add", trend="add" if trend else None, damped_trend=damped)
        return model.fit(disp=False, maxiter=100)


def _ets_ahead(fit: ETSResults, steps: int) -> tuple[Array, Array]:
    """The forecast with its variance in closed form (Hyndman et al. 2008, table 6.1)."""
    parameters = dict(zip(fit.param_names, fit.params, strict=True))
    level = parameters["smoothing_level"]
    trend = parameters.get("smoothing_trend", 0.0)
    damping = parameters.get("damping_trend", 1.0)
    weights = level + trend * np.cumsum(damping ** np.arange(1, steps))
    variance = fit.scale * np.concatenate(([1.0], 1.0 + np.cumsum(weights**2)))
    return np.asarray(fit.forecast(steps)), np.sqrt(variance)


def auto_arima(series: Array, steps: int) -> tuple[Array, Array]:
    """ARIMA without season, its order by the stepwise search of Hyndman & Khandakar (2008): KPSS for d, AICc for p, q.

    As there: at most two differences, a constant with at most one. The search compares approximate fits (`_arma_aicc`);
    only the chosen order is fitted by maximum likelihood. No more than MAX_ORDER terms of either kind.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        differences, rest = 0, series
        while differences < 2 and np.ptp(rest) > 0 and kpss(rest, nlags="auto")[1] < SIGNIFICANCE_LEVEL:
            differences, rest = differences + 1, np.diff(rest)
        constants = (False, True) if differences < 2 else (False,)
        criteria: dict[tuple[int, int, bool], float] = {}
        ahead = [(p, q, constant) for p, q in ((2, 2), (0, 0), (1, 0), (0, 1)) for constant in constants]
        best = ahead[0]
        while ahead:
            criteria |= {order: _arma_aicc(rest, *order) for order in ahead}
            best = min(criteria, key=lambda order: criteria[order])
            near = [(best[0] + p, best[1] + q) for p, q in product((-1, 0, 1), repeat=2) if p * q >= 0]
            inside = [(p, q) for p, q in near if 0 <= p <= MAX_ORDER and 0 <= q <= MAX_ORDER]
            ahead = [
                (*order, constant) for order in inside for constant in constants if (*order, constant) not in criteria
            ]
        p, q, constant = best
        # A constant under one difference is a drift: statsmodels writes it as a trend of the levels.
        trend = ("c" if differences == 0 else "t") if constant else "n"
        fit = SARIMAX(series, order=(p, differences, q), trend=trend).fit(disp=0, maxiter=50)
        forecast = fit.get_forecast(steps)
        return np.asarray(forecast.predicted_mean), np.asarray(forecast.se_mean)


def _arma_aicc(series: Array, p: int, q: int, constant: bool) -> float:
    """AICc of an ARMA fitted by Hannan & Rissanen (1982), from its conditional sum of squares; infinite if unusable."""
    centred = series - series.mean() if constant else series
    try:
        fitted = hannan_rissanen(centred, ar_order=p, ma_order=q, demean=False)[0] if p + q else None
    except (ValueError, np.linalg.LinAlgError):  # too few points for these orders, or collinear lags
        return float("inf")
    if fitted is not None and not (fitted.is_stationary and fitted.is_invertible):
        return float("inf")
    residuals = centred if fitted is None else scipy.signal.lfilter(fitted.ar_poly.coef, fitted.ma_poly.coef, centred)
    n, parameters = centred.size, p + q + constant + 1
    squares = max(float(np.mean(residuals**2)), np.finfo(float).tiny)
    return float(n * np.log(squares) + 2.0 * parameters * n / (n - parameters - 1))


def auto_theta(series: Array, steps: int) -> tuple[Array, Array]:
    """The optimised Theta model (Fiorucci et al. 2016): level, smoothing and theta of the least squared errors.

    With theta = 2 it is the standard Theta method (Assimakopoulos & Nikolopoulos 2000).
    """
    n = series.size
    times = np.arange(1, n + 1)
    slope, intercept = np.polyfit(times, series, 1)

    def ahead(parameters: Array) -> tuple[Array, Array]:
        """One-step forecasts (n,) and the levels after each reading (n,)."""
        smoothing, theta, start = parameters
        levels = scipy.signal.lfilter([smoothing], [1.0, smoothing - 1.0], series, zi=[(1.0 - smoothing) * start])[0]
        before = np.concatenate(([start], levels[:-1]))
        left = (1.0 - smoothing) ** (times - 1)
        trend = (1.0 - 1.0 / theta) * (left * intercept + (1.0 - left * (1.0 - smoothing)) / smoothing * slope)
        return before + trend, levels

    def squares(parameters: Array) -> float:
        return float(np.mean((series - ahead(parameters)[0]) ** 2))

    found = scipy.optimize.minimize(
        squares,
        x0=np.array([0.5, 2.0, series[0] / 2.0]),
        bounds=[(0.05, 0.999), (1.0, 10.0), (-np.inf, np.inf)],
        method="L-BFGS-B",
    )
    smoothing, theta, _ = found.x
    one_step, levels = ahead(found.x)
    left = (1.0 - smoothing) ** n
    steady = (1.0 - 1.0 / theta) * (left * intercept + (1.0 - left * (1.0 - smoothing)) / smoothing * slope)
    further = np.arange(steps)
    mean = levels[-1] + steady + (1.0 - 1.0 / theta) * slope * further
    variance = float(np.var(series - one_step)) * (1.0 + further * smoothing**2)
    return np.asarray(mean), np.sqrt(variance)
