"""The special functions that a running gateway needs, by the standard library's: scipy's take 13 MB once loaded.

Each follows the published formula that it names, and tests hold each against scipy's, which laboratory code uses.
"""

import math
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
_ERFC = np.vectorize(math.erfc, otypes=[float])
_ASYMPTOTIC_SIGMAS = 30.0
"""Standard deviations beyond which the normal tail is its asymptotic series: what that leaves out is below 1e-13."""
_STEPS, _LAST_STEP = 60, 1e-8
"""Most steps of a search, and the length of step after which Newton's next one would move the last digit only."""
_NORMAL = NormalDist()


def log_normal_cdf(z: ArrayLike) -> Array:
    """ln P(Z <= z) of a standard normal Z, of any shape, to a relative 1e-13; far out too, where P itself is 0."""
    x = np.asarray(z, dtype=float)
    far = np.minimum(x, -_ASYMPTOTIC_SIGMAS)
    tail = 0.5 * _ERFC(np.minimum(np.abs(x), _ASYMPTOTIC_SIGMAS) / math.sqrt(2.0))
    beyond = -0.5 * far * far - np.log(-far) - _HALF_LOG_2PI + _mills(far)
    return np.asarray(np.where(x >= 0.0, np.log1p(-tail), np.where(x > -_ASYMPTOTIC_SIGMAS, np.log(tail), beyond)))


def normal_quantile_of_log(s: ArrayLike) -> Array:
    """The z with ln P(Z <= z) = s <= 0, of any shape: the inverse of `log_normal_cdf`, to 1e-13 of 1 or of z.

    Wichura's algorithm AS 241 (1988), which takes the tails by the logarithm as they are given here, and beyond what
    it covers the asymptotic series solved for z. 0 gives inf, -inf gives -inf.
    """
    logs = np.asarray(s, dtype=float)
    off = np.exp(logs) - 0.5
    away = np.abs(off)
    z = np.asarray(away * _ratio(0.180625 - off * off, *_CENTRE))
    outer = away > 0.425
    if np.any(outer):
        z[outer] = _outer_quantile(logs[outer])
    return np.asarray(np.copysign(z, off))


def _outer_quantile(logs: Array) -> Array:
    """The distance |z| of those outside of the centre, (n,)."""
    with np.errstate(divide="ignore"):
        # The logarithm of the smaller of the two tails, without a difference of nearly equal numbers.
        tail = np.where(logs < -math.log(2.0), logs, np.log(-np.expm1(logs)))
    root = np.sqrt(-tail)
    middle, beyond = root <= 5.0, root > _MAX_TAIL_ROOT
    z = _ratio(np.where(middle, root - 1.6, 0.0), *_MIDDLE)
    if not np.all(middle):
        z = np.where(middle, z, _ratio(np.where(beyond, 0.0, root - 5.0), *_OUTER))
    if np.any(beyond):
        z[beyond] = _far_quantile(tail[beyond])
    return z


_MAX_TAIL_ROOT = 27.0
"""The root of a tail's logarithm to which AS 241 reaches: a probability of 1e-316."""


def _far_quantile(tail: Array) -> Array:
    """The distance z > 38 at which the normal tail is exp(tail): z^2 = -2 tail - ln(2 pi z^2) + 2 ln(1 - 1/z^2 ...).

    Put in on the right, an error of z^2 comes out smaller by z^2 itself: five times are enough for 1e-15.
    """
    known = np.isfinite(tail)
    z = first = np.sqrt(-2.0 * np.where(known, tail, -(_MAX_TAIL_ROOT**2)))
    for _ in range(5):
        z = np.sqrt(first * first - 2.0 * (_HALF_LOG_2PI + np.log(z) - _mills(z)))
    return np.where(known, z, np.inf)


def _mills(z: Array) -> Array:
    """ln(1 - 1/z^2 + 3/z^4 - 15/z^6 + 105/z^8): by which Mills' ratio of the normal tail differs from 1/|z|."""
    w = 1.0 / (z * z)
    return np.log1p(-w * (1.0 - 3.0 * w * (1.0 - 5.0 * w * (1.0 - 7.0 * w))))


def _ratio(r: Array, above: tuple[float, ...], below: tuple[float, ...]) -> Array:
    """The quotient of two polynomials, coefficients from the highest power down."""
    top, bottom = np.full_like(r, above[0]), np.full_like(r, below[0])
    for a, b in zip(above[1:], below[1:], strict=True):
        top *= r
        top += a
        bottom *= r
        bottom += b
    return np.divide(top, bottom, out=top)


# AS 241, PPND16: the coefficients a and b (centre), c and d (to a root of 5), e and f (beyond).
_CENTRE = (
    (
        2.5090809287301226727e3,
        3.3430575583588128105e4,
        6.7265770927008700853e4,
        4.5921953931549871457e4,
        1.3731693765509461125e4,
        1.9715909503065514427e3,
        1.3314166789178437745e2,
        3.3871328727963666080e0,
    ),
    (
        5.2264952788528545610e3,
        2.8729085735721942674e4,
        3.9307895800092710610e4,
        2.1213794301586595867e4,
        5.3941960214247511077e3,
        6.8718700749205790830e2,
        4.2313330701600911252e1,
        1.0,
    ),
)
_MIDDLE = (
    (
        7.74545014278341407640e-4,
        2.27238449892691845833e-2,
        2.41780725177450611770e-1,
        1.27045825245236838258e0,
        3.64784832476320460504e0,
        5.76949722146069140550e0,
        4.63033784615654529590e0,
        1.42343711074968357734e0,
    ),
    (
        1.05075007164441684324e-9,
        5.47593808499534494600e-4,
        1.51986665636164571966e-2,
        1.48103976427480074590e-1,
        6.89767334985100004550e-1,
        1.67638483018380384940e0,
        2.05319162663775882187e0,
        1.0,
    ),
)
_OUTER = (
    (
        2.01033439929228813265e-7,
        2.71155556874348757815e-5,
        1.24266094738807843860e-3,
        2.65321895265761230930e-2,
        2.96560571828504891230e-1,
        1.78482653991729133580e0,
        5.46378491116411436990e0,
        6.65790464350110377720e0,
    ),
    (
        2.04426310338993978564e-15,
        1.42151175831644588870e-7,
        1.84631831751005468180e-5,
        7.86869131145613259100e-4,
        1.48753612908506148525e-2,
        1.36929880922735805310e-1,
        5.99832206555887937690e-1,
        1.0,
    ),
)


def chi_square_tail(squares: float, degrees: int) -> float:
    """P(a chi-square variable with `degrees` >= 1 degrees of freedom exceeds `squares`), to a relative 1e-12.

    The finite sums of Abramowitz & Stegun 26.4.4 and 26.4.5: of Poisson probabilities where the degrees are even, of
    the same at half-integers beside a normal tail where they are odd.
    """
    half = 0.5 * squares
    if not 0.0 < half < math.inf:
        return 0.0 if half > 0.0 else 1.0
    odd, count = degrees % 2, degrees // 2
    tail = math.erfc(math.sqrt(half)) if odd else 0.0
    if count:
        # From the greatest term both ways, so that none of those that count underflows.
        powers = [0.5 * odd + step for step in range(count)]
        middle = min(int(half), count - 1)
        greatest = math.exp(powers[middle] * math.log(half) - half - math.lgamma(powers[middle] + 1.0))
        tail += greatest
        term = greatest
        for power in powers[middle:0:-1]:
            term *= power / half
            tail += term
        term = greatest
        for power in powers[middle + 1 :]:
            term *= half / power
            tail += term
    return min(tail, 1.0)


def beta_quantile(a: float, b: float, p: float) -> float:
    """The x with I_x(a, b) = p of the regularised incomplete beta function, to 1e-11 of it or 1e-16.

    0 < a <= 10^6, 1 <= b <= 10^6, 0 < p <= 1/2. ln I is concave in ln x, so that Newton's steps there
    converge from wherever they begin.
    """
    log_beta = _log_beta(a, b)
    log_p = math.log(p)
    # Where b >= 1 the power series' first term alone is too high, so this is below the solution; mostly nearer to it
    # is the quantile of a normal law of the log odds.
    low = (log_p + math.log(a) + log_beta) / a
    log_odds = math.log(a / b) + _NORMAL.inv_cdf(p) * math.sqrt(1.0 / a + 1.0 / b)
    log_x = max(low, -math.log1p(math.exp(-log_odds)) if log_odds > -700.0 else log_odds)
    for _ in range(_STEPS):
        log_value, log_slope = _log_incomplete_beta(log_x, a, b, log_beta)
        step = (log_p - log_value) * math.exp(log_value - log_slope)
        log_x = min(max(log_x + step, low), -1e-300)
        if abs(step) < _LAST_STEP:
            break
    return math.exp(log_x)


def _log_beta(a: float, b: float) -> float:
    """ln B(a, b) for positive a and b."""
    small, large = min(a, b), max(a, b)
    if large < _MIN_STIRLING:
        return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)
    # ln G(b) - ln G(a + b) by Stirling's series, whose large parts cancel by formula (Didonato & Morris 1992): as a
    # difference of floats it would lose as many digits as b has.
    both = small + large
    less = (both - 0.5) * math.log1p(small / large) + small * (math.log(large) - 1.0)
    return math.lgamma(small) - less + _stirling_rest(large) - _stirling_rest(both)


_MIN_STIRLING = 15.0
"""From here on what Stirling's series leaves out is below 1e-15."""


def _stirling_rest(x: float) -> float:
    """ln G(x) - ((x - 1/2) ln x - x + ln(2 pi) / 2) for x >= 15."""
    w = 1.0 / (x * x)
    return (1 / 12 - w * (1 / 360 - w * (1 / 1260 - w * (1 / 1680 - w / 1188)))) / x


def _log_incomplete_beta(log_x: float, a: float, b: float, log_beta: float) -> tuple[float, float]:
    """ln I_x(a, b), and ln(x dI/dx), at x = exp(log_x) below 1."""
    x, rest = math.exp(log_x), -math.expm1(log_x)
    log_rest = math.log(rest)
    powers = a * log_x + b * log_rest - log_beta
    slope = powers - log_rest
    # The fraction converges fast on the near side of the mean; on the other one the complement's does.
    if x < (a + 1.0) / (a + b + 2.0):
        return powers - math.log(a) + math.log(_fraction(x, a, b)), slope
    complement = math.exp(powers - math.log(b)) * _fraction(rest, b, a)
    return math.log1p(-min(complement, 1.0 - 1e-16)), slope


def _fraction(x: float, a: float, b: float) -> float:
    """The continued fraction of the incomplete beta function (DLMF 8.17.22) by Lentz' method."""
    tiny = 1e-300
    numerator, denominator = 1.0, 1.0 - (a + b) * x / (a + 1.0)
    denominator = 1.0 / (denominator or tiny)
    value, n = denominator, 1
    while True:
        for term in (
            n * (b - n) * x / ((a + 2 * n - 1.0) * (a + 2 * n)),
            -(a + n) * (a + b + n) * x / ((a + 2 * n) * (a + 2 * n + 1.0)),
        ):
            denominator = 1.0 / ((1.0 + term * denominator) or tiny)
            numerator = (1.0 + term / numerator) or tiny
            change = numerator * denominator
            value *= change
        if abs(change - 1.0) < 1e-15:
            return value
        n += 1
