"""The learned automaton: fitted locations, borrowed ones for what was never seen, honest ones for what is unknown."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.engine import linear_recursion
from sim.lab.learning import (
    Context,
    FitShape,
    FreeRunFit,
    FreeRuns,
    Indices,
    MachineSpread,
    NoiseLevels,
    contexts,
    drift_noise,
    first_switch,
    loads,
    location_name,
    nearest,
    next_stay,
    steps,
    with_parameters,
)
from sim.lab.learning.bins.candidates import Basis, process_groups
from sim.sha import SHA, Alphabet, Array, Distribution, Flow, Location

MIN_BORROWED_SIGMA_DEGC = 5.0
"""degC added (in quadrature) to the sigma of a target that is borrowed, at least."""
MAX_TARGET_SIGMA_DEGC = 20.0
"""degC: a location whose target is not known better than this (half the prior's spread) counts as not seen."""


@dataclass(frozen=True, slots=True)
class LocationFit:
    """What was learned about one location: `source` is `fitted`, `borrowed from X` or `unknown`.

    `readings` end a step there, `seconds` and `stays` were spent there. `mu`, `sigma` (degC) and `k` (1/s) are the
    model's; `mu_error` (degC), `k_error` (relative) and `gain_errors` are standard errors; `gains` by signal, degC per
    unit. NaN where there is none.
    """

    name: str
    source: str
    readings: int
    seconds: float
    stays: int
    mu: float
    mu_error: float
    sigma: float
    k: float
    k_error: float
    gains: Mapping[str, float]
    gain_errors: Mapping[str, float]


def well_known_locations(sha: SHA, shape: FitShape, fit: FreeRunFit, base: Basis) -> Basis:
    """`base` with only those seen locations whose target the data tell to within MAX_TARGET_SIGMA_DEGC (the best one at
    least)."""
    error = {
        location.name: float(fit.errors_at_rates[shape.target[place]])
        for place, location in enumerate(sha.locations)
        if location.name in base.seen
    }
    best = min(error, key=lambda name: error[name])
    return replace(base, seen=tuple(name for name in base.seen if name == best or error[name] < MAX_TARGET_SIGMA_DEGC))


def learned_sha(
    name: str,
    sha: SHA,
    *,
    shape: FitShape,
    fit: FreeRunFit,
    noise: NoiseLevels,
    spread: MachineSpread,
    runs: FreeRuns,
    base: Basis,
) -> SHA:
    """`sha` with all parameters, and every location that `base` has not seen filled in.

    A seen location's m scatters as `next_stay` says of the fitted sigma, and by what is not known of its mean. A known
    location without data takes flow and mean of its nearest seen neighbour; its sigma is doubled, and the scatter of
    all seen means (5 degC at least) is added. A standstill of which no data are there has no heat: it goes towards the
    lowest temperature that was read, at its neighbour's rate, and may stop anywhere between that and half the way to
    where the machine runs. Locations in which a channel is unknown keep the temperature, with the noise of
    `drift_noise`.
    """
    groups, drift = process_groups(base.alphabet), drift_noise(runs)
    seen: dict[str, Location] = {}
    laws: dict[str, Distribution] = {}
    for place, location in enumerate(with_parameters(sha, shape, fit).locations):
        if location.name not in base.seen:
            continue
        column = shape.target[place]
        stays = np.unique(runs.stay[(runs.place == place) & ~runs.first]).size
        scatter = next_stay(float(noise.scatter[place]), stays, location.flow.kind)
        sigma = float(np.hypot(scatter, fit.errors_at_rates[column]))
        params = {**location.flow.params, "noise": float(noise.process[groups[place]])}
        law = Distribution("normal", {"mu": float(fit.linear[column]), "sigma": sigma})
        laws[location.name] = law
        seen[location.name] = replace(location, flow=replace(location.flow, params=params), distribution=law)
    # What was never seen is as far off as locations differ from one another, besides what the lender does not know.
    doubt = max(float(np.std([law.params["mu"] for law in laws.values()])), MIN_BORROWED_SIGMA_DEGC)
    known = contexts(base.alphabet)
    coldest = float(np.nanmin(runs.reading))
    locations: list[Location] = []
    for title in (each.name for each in sha.locations):
        if title in seen:
            locations.append(seen[title])
        elif None in known[title]:
            locations.append(Location(title, Flow("constant", {"noise": drift}), entry="none"))
        else:
            lender = find_lender(title, base)
            mu, sigma = laws[lender].params["mu"], laws[lender].params["sigma"]
            flow, sigma = seen[lender].flow, float(np.hypot(2.0 * sigma, doubt))
            if _at_rest(known[title], base.alphabet) and not _at_rest(known[lender], base.alphabet):
                sigma = max(0.25 * abs(mu - coldest), sigma, MIN_BORROWED_SIGMA_DEGC)
                # Nothing that drives the heat of a running machine drives that of one which stands.
                mu, flow = coldest, replace(flow, kind="exponential", inputs=())
            locations.append(Location(title, flow, Distribution("normal", {"mu": mu, "sigma": sigma})))
    effects = (*noise.effects, *spread.effects)
    return replace(sha, name=name, locations=tuple(locations), effects=effects)


def _at_rest(context: Context, alphabet: Alphabet) -> bool:
    """Whether the machine's switch is off in a context; without a switch nothing says so."""
    switch = first_switch(alphabet)
    return switch is not None and context[alphabet.channels.index(switch)] == 0


def find_lender(name: str, base: Basis) -> str:
    """The seen location whose parameters an unseen one borrows."""
    known = contexts(base.alphabet)
    return location_name(nearest(known[name], [known[each] for each in base.seen], base.alphabet), base.alphabet)


def parameter_source(name: str, base: Basis) -> str:
    """`fitted`, `borrowed from X` or `unknown`."""
    if name in base.seen:
        return "fitted"
    return "unknown" if None in contexts(base.alphabet)[name] else f"borrowed from {find_lender(name, base)}"


def location_fits(sha: SHA, shape: FitShape, fit: FreeRunFit, runs: FreeRuns, base: Basis) -> tuple[LocationFit, ...]:
    """The table of locations, in the automaton's order."""
    table: list[LocationFit] = []
    errors, first, nan = fit.errors, runs.first, float("nan")
    for place, location in enumerate(sha.locations):
        rows = (runs.place == place) & ~first
        law = location.distribution.params if location.distribution is not None else {}
        target, rate = int(shape.target[place]), int(shape.rate[place])
        columns = {base.signals[number]: int(column) for number, column in enumerate(shape.gain[place]) if column >= 0}
        # A borrowed location has parameters, but no standard errors: those would be another location's.
        own = location.name in base.seen
        table.append(
            LocationFit(
                name=location.name,
                source=parameter_source(location.name, base),
                readings=int(np.isfinite(runs.reading[rows]).sum()),
                seconds=float(runs.dt[rows].sum()),
                stays=int(np.unique(runs.stay[rows]).size),
                mu=law.get("mu", nan),
                mu_error=float(errors[target]) if own else nan,
                sigma=law.get("sigma", nan),
                k=location.flow.params.get("k", nan),
                k_error=float(errors[fit.linear.size + rate]) if own else nan,
                gains={driver.signal: driver.gain for driver in location.flow.inputs},
                gain_errors={signal: float(errors[column]) for signal, column in columns.items() if own},
            )
        )
    return tuple(table)


def stay_values(
    runs: FreeRuns, sha: SHA, *, shape: FitShape, fit: FreeRunFit, noise: NoiseLevels, base: Basis
) -> dict[str, tuple[float, ...]]:
    """The m of each stay by least squares (its temperature at the start free), by location: the histogram's values.

    Only stays that tell their m to within twice the location's sigma are there; a location without any gives its mean.
    """
    value, error, place = _stay_parameters(runs, shape, fit, noise, process_groups(base.alphabet)[runs.place])
    values: dict[str, tuple[float, ...]] = {}
    for number, location in enumerate(sha.locations):
        law = location.distribution
        if location.name not in base.seen or law is None:
            continue
        known = (place == number) & (error <= 2.0 * law.params["sigma"])
        values[location.name] = tuple(value[known].tolist()) or (law.params["mu"],)
    return values


def _stay_parameters(
    runs: FreeRuns, shape: FitShape, fit: FreeRunFit, noise: NoiseLevels, group: Indices
) -> tuple[Array, Array, Array]:
    """(m, its standard error, location) of each stay: X = start decayed + weighted m + inputs, two unknowns."""
    decay, pull = steps(runs, shape, np.log(fit.rates))
    begins = (np.diff(runs.stay, prepend=-1) != 0) | runs.first
    # Decay 0 where a stay begins: one recursion over all knots starts anew in each. `start` and `mode` are the courses
    # that a unit of a stay's start temperature and of its m would make.
    inside = np.where(begins, 0.0, decay)
    start = linear_recursion(inside, np.where(runs.first, 1.0, np.where(begins, decay, 0.0)), 0.0)
    mode = linear_recursion(inside, pull, 0.0)
    offset = loads(runs, shape) @ np.where(np.isin(np.arange(fit.linear.size), shape.target), 0.0, fit.linear)
    pushed = linear_recursion(inside, pull * offset, 0.0)
    use = np.isfinite(runs.reading) & ~runs.first
    stay, rest = np.cumsum(begins)[use] - 1, (runs.reading - pushed)[use]
    size = int(begins.sum())
    ss, sm, mm, sy, my = (
        np.bincount(stay, a * b, size)
        for a, b in (
            (start[use], start[use]),
            (start[use], mode[use]),
            (mode[use], mode[use]),
            (start[use], rest),
            (mode[use], rest),
        )
    )
    seconds = np.add.reduceat(runs.dt, np.flatnonzero(begins))
    # The two unknowns' normal equations, the start eliminated: what is left is the information that m has of its own.
    with np.errstate(divide="ignore", invalid="ignore"):
        information = mm - sm**2 / ss
        value = (my - sm * sy / ss) / information
        error = np.sqrt((noise.sensor**2 + noise.process[group[begins]] ** 2 * seconds) / information)
    good = np.isfinite(value) & (information > 1e-9 * mm)
    return value, np.where(good, error, np.inf), runs.place[begins]
