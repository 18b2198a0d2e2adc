"""A given automaton fitted anew to traces: its structure and flows stay, its parameters get the greatest likelihood."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.lab.learning.free_run import FitShape, FreeRunFit, Loss, fit_free_run
from sim.lab.learning.runs import FreeRuns, free_runs, sample_runs
from sim.lab.learning.shape import ParameterNames, Prior, build_shape, with_parameters
from sim.lab.learning.structure import LearningError
from sim.sha import SHA, Trace

MAX_KNOTS = 40_000
TARGET_SPREAD_DEGC = 40.0
INPUT_SWING_DEGC = 40.0
"""degC that an input may move a target by, over one standard deviation of it: the spread of the gains' prior."""


@dataclass(frozen=True, slots=True)
class Refit:
    """`sha` with the fitted parameters, the fit, what its numbers stand for (`names`), and the runs it was made on."""

    sha: SHA
    fit: FreeRunFit
    shape: FitShape
    names: ParameterNames
    runs: FreeRuns


def refit(
    sha: SHA,
    traces: Sequence[Trace],
    temperature: str,
    *,
    rising: str | None = None,
    rates: Mapping[str, str] | None = None,
    gains: Mapping[str, str] | None = None,
    cycle: float = 3600.0,
    loss: Loss = "huber",
) -> Refit:
    """Every m, rate and gain of the locations that the encoded traces stay in, by free-run maximum likelihood.

    `rates` and `gains` map a location to the group with which it shares them (default: each its own). A start-up
    (`rising`) begins a new start temperature once a run has lasted `cycle` seconds. Locations without data, all
    `constant` ones, noise and sigmas stay as they are. The saturation of the rates is not looked at.

    Raises LearningError when the traces do not fit the automaton or leave nothing to fit.
    """
    signals = tuple(dict.fromkeys(driver.signal for location in sha.locations for driver in location.flow.inputs))
    moving = np.array([location.flow.kind != "constant" for location in sha.locations])
    runs = sample_runs(
        free_runs(traces, sha, temperature, signals=signals, modelled=moving, rising=rising, cycle=cycle), MAX_KNOTS
    )
    seen = [sha.locations[place].name for place in np.unique(runs.place[~runs.first])]
    if not seen:
        raise LearningError(f"the traces stay in no location of SHA {sha.name!r} that has something to fit")
    reading = runs.reading[np.isfinite(runs.reading)]
    known = {signal: runs.inputs[np.isfinite(runs.inputs[:, n]), n] for n, signal in enumerate(signals)}
    # An input that never moves says nothing of its gain, and would divide by 0 here.
    spreads = {
        signal: INPUT_SWING_DEGC / float(np.std(values)) for signal, values in known.items() if np.ptp(values) > 0
    }
    prior = Prior((float(np.median(reading)), TARGET_SPREAD_DEGC), spreads)
    shape, names = build_shape(sha, seen, signals, prior, rates=rates, gains=gains)
    fit = fit_free_run(runs, shape, loss=loss)
    return Refit(with_parameters(sha, shape, fit), fit, shape, names, runs)
