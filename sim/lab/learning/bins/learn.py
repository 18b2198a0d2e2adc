"""Method `bins`: the first model, one location for each combination of channel values, learned by its free runs.

It is the baseline that a real learner has to beat. Everything is decided by the data in one pass: which locations exist
in them, whether targets follow the inputs, and which locations share a rate (cross-validated, `held_out`); then the
means (`free_run`), the noise (`noise`), how long stays last (`semi_markov`) and how far the bands must be widened
(`calibrate`, on traces or times that a model of the same kind was not fitted to).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.lab.learning import (
    MIN_TRAINING_READINGS,
    Coverage,
    FreeRunFit,
    FreeRuns,
    HeldOutErrors,
    HeldOutForecasts,
    LearningError,
    MachineSpread,
    Memories,
    NoiseLevels,
    bare_sha,
    check_data,
    choose,
    cross_validate,
    first_switch,
    fit_free_run,
    fit_noise,
    fit_stays,
    folds,
    free_runs,
    in_order,
    initial_law,
    judged_part,
    learn_plain,
    level_signals,
    machine_spread,
    observable_memories,
    sample_runs,
    splits,
    trace_machines,
    training_errors,
    with_events,
    with_range,
)
from sim.lab.learning.bins.assemble import (
    LocationFit,
    learned_sha,
    location_fits,
    parameter_source,
    stay_values,
    well_known_locations,
)
from sim.lab.learning.bins.candidates import (
    CANDIDATES,
    Basis,
    BinsCandidate,
    build,
    build_basis,
    distinct,
    modelled_places,
    process_groups,
)
from sim.sha import Alphabet, Array, Model, Provenance, Trace, check_alphabet, content_hash, signal_unit

CHOICE_BUDGET, FIT_BUDGET, PART_BUDGET = 3_000, 40_000, 6_000
"""Knots to which the runs are sampled for cross-validation, for the last fit and for the fits of the calibration."""
MIN_RUN_S = 3600.0
"""Seconds that a free run lasts at least before the next start-up begins a new one."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class CandidateScore:
    """A row of the table of candidates: held-out figures are NaN when there were too few data to hold any out.

    `likelihood` is the held-out log-likelihood per reading; errors are of free runs, in degC.
    """

    label: str
    parameters: int
    likelihood: float
    held_out_rmse: float
    held_out_mae: float
    train_rmse: float
    train_mae: float
    chosen: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Learned:
    """A learned model, the m of each stay by location (for the histogram file) and how it came about."""

    model: Model
    values: Mapping[str, tuple[float, ...]]
    candidates: tuple[CandidateScore, ...]
    locations: tuple[LocationFit, ...]
    noise: NoiseLevels
    coverage: tuple[Coverage, ...]
    spread: MachineSpread


@dataclass(frozen=True, slots=True, kw_only=True)
class _FittedCandidate:
    """One candidate fitted to some traces: all that a model is made of but its calibration."""

    model: Model
    values: Mapping[str, tuple[float, ...]]
    locations: tuple[LocationFit, ...]
    fit: FreeRunFit
    noise: NoiseLevels
    spread: MachineSpread


def learn_bins(
    traces: Sequence[Trace],
    alphabet: Alphabet,
    temperature: str,
    *,
    seed: int,
    name: str = "bins",
    candidates: Sequence[BinsCandidate] = CANDIDATES,
    data_hash: str = "",
    bands: bool = True,
    progress: Progress | None = None,
) -> Learned:
    """The model of greatest free-run likelihood over the product automaton of `alphabet`, for the signal `temperature`.

    Traces without events are encoded by `alphabet`. The result depends on the traces' content and names, `seed` and the
    settings, not on the order of the traces; copies count once. `data_hash` defaults to the SHA-256 over their content.
    Without `bands` it is not held against what it did not see, for which it is fitted two or three times more, and has
    no calibration: enough for who looks at its mean and its noise.
    `progress` is called with what is being done and the share that is done (0 to 1).

    Raises LearningError (a ValueError), in one sentence, when the traces cannot teach a model.
    """
    report = progress or (lambda _stage, _share: None)
    check_alphabet(alphabet)
    encoded_traces = [with_events(trace, alphabet) for trace in traces if trace.times.size]
    ordered, digest = in_order(encoded_traces)
    report("reading the traces", 0.0)
    runs, base = _ground(ordered, alphabet, temperature)
    scores, chosen, begin = _select(runs, base, candidates, report)
    report("fitting the chosen candidate", 0.6)
    fitted = _fit_candidate(
        name,
        ordered,
        runs=runs,
        base=base,
        candidate=chosen,
        begin=begin,
        temperature=temperature,
        budget=FIT_BUDGET,
        memories=observable_memories(ordered, temperature),
    )
    del runs  # of a week at 1 Hz an eighth of what a retraining may take; the parts make their own
    report("calibrating the bands", 0.75)
    forecasts = HeldOutForecasts([], seed)
    if bands:
        forecasts = _held_out_forecasts(ordered, alphabet, temperature, candidate=chosen, whole=fitted, seed=seed)
    coverage = forecasts.coverage
    report("done", 1.0)
    nan = float("nan")
    table = tuple(
        CandidateScore(
            label=candidate.label,
            parameters=size,
            likelihood=nan if held is None else held.score,
            held_out_rmse=nan if held is None else held.rmse,
            held_out_mae=nan if held is None else held.mae,
            train_rmse=train_rmse,
            train_mae=train_mae,
            chosen=candidate == chosen,
        )
        for candidate, held, size, (train_rmse, train_mae) in scores
    )
    winner = next(row for row in table if row.chosen)
    figures = {
        "held_out_log_likelihood": winner.likelihood,
        "held_out_rmse": winner.held_out_rmse,
        "held_out_mae": winner.held_out_mae,
        "train_rmse": winner.train_rmse,
        "train_mae": winner.train_mae,
        "residual_sigma": fitted.fit.sigma,
    }
    figures |= {f"coverage90_before_{row.horizon:.0f}s": row.covered for row in coverage}
    figures |= {f"crps_{row.horizon:.0f}s": row.crps for row in coverage}
    borrowed = [f"{each.name} {each.source}" for each in fitted.locations if each.source.startswith("borrowed")]
    provenance = Provenance(
        method="bins",
        data_hash=data_hash or digest,
        traces=tuple(sorted(trace.name for trace in ordered)),
        contents=tuple(sorted(content_hash(trace) for trace in ordered)),
        synthetic=any(trace.synthetic for trace in ordered),
        settings={
            "seed": seed,
            "candidate": chosen.label,
            "flow": chosen.flow,
            "rates": chosen.rates,
            "gains": chosen.gains,
            "loss": "huber",
            "cycle_s": MIN_RUN_S,
            "copies_left_out": len(encoded_traces) - len(ordered),
            "borrowed": "; ".join(borrowed),
        },
        # JSON has no NaN: a figure for which there were too few data is left out of the model's file.
        scores={name: value for name, value in figures.items() if np.isfinite(value)},
    )
    model = replace(
        fitted.model,
        calibration=forecasts.calibration,
        plain=forecasts.members,
        anomalies=forecasts.scores.record,
        provenance=provenance,
    )
    return Learned(
        model=model,
        values=fitted.values,
        candidates=table,
        locations=fitted.locations,
        noise=fitted.noise,
        coverage=coverage,
        spread=fitted.spread,
    )


def _ground(traces: Sequence[Trace], alphabet: Alphabet, temperature: str) -> tuple[FreeRuns, Basis]:
    """The free runs through the locations that the data can teach, and what candidates are built on."""
    check_data(traces, temperature)
    sha, signals = bare_sha(alphabet), level_signals(alphabet)
    switch = first_switch(alphabet)
    rising = switch.rising if switch else None
    # Twice, because which locations the data can teach is seen only in the runs; the others then cut them.
    everywhere = free_runs(traces, sha, temperature, signals=signals, rising=rising, cycle=MIN_RUN_S)
    modelled = modelled_places(everywhere, alphabet)
    del everywhere
    runs = free_runs(traces, sha, temperature, signals=signals, modelled=modelled, rising=rising, cycle=MIN_RUN_S)
    count = int(np.isfinite(runs.reading).sum())
    if count < MIN_TRAINING_READINGS or not runs.dt.sum() > 0:
        raise LearningError(
            f"only {count} readings of {temperature!r} fall into known locations, over {runs.dt.sum():.0f} s; "
            f"a model needs at least {MIN_TRAINING_READINGS}, at different times"
        )
    return runs, build_basis(runs, alphabet)


Scores = list[tuple[BinsCandidate, HeldOutErrors | None, int, tuple[float, float]]]


def _select(
    runs: FreeRuns, base: Basis, candidates: Sequence[BinsCandidate], report: Progress
) -> tuple[Scores, BinsCandidate, Array]:
    """(every candidate's figures, the chosen one, its rates): the held-out likelihood decides."""
    # All candidates on the same knots and the same folds: their likelihoods differ by what they are, not by the draw.
    few = sample_runs(runs, CHOICE_BUDGET)
    cut = folds(few)
    judged = judged_part(cut) if cut is not None else None
    rivals = distinct(candidates, base)
    scores: Scores = []
    rates = []
    for number, candidate in enumerate(rivals):
        report(f"trying: {candidate.label}", 0.1 + 0.5 * number / len(rivals))
        _, shape, _ = build(candidate, base)
        fit = fit_free_run(few, shape)
        held = None
        if cut is not None and judged is not None:
            held = cross_validate(cut, shape, fit.rates, judged=judged)
        scores.append((candidate, held, shape.centre.size + shape.rate_centre.size, training_errors(few, fit)))
        rates.append(fit.rates)
    held_out = [held for _, held, _, _ in scores if held is not None]
    sizes = [size for _, _, size, _ in scores]
    # One candidate that could not be held out makes the scores incomparable; the smallest is then the safest.
    best = choose(held_out, sizes) if len(held_out) == len(scores) else sizes.index(min(sizes))
    return scores, scores[best][0], rates[best]


def _fit_candidate(
    name: str,
    traces: Sequence[Trace],
    *,
    runs: FreeRuns,
    base: Basis,
    candidate: BinsCandidate,
    begin: Array | None,
    temperature: str,
    budget: int,
    memories: Memories | None = None,
    spread: MachineSpread | None = None,
) -> _FittedCandidate:
    sha, shape, _ = build(candidate, base)
    few = sample_runs(runs, budget)
    # Means first, then the noise about them; a location whose target came out too vague counts as not seen after all.
    fit = fit_free_run(few, shape, begin=begin)
    noise = fit_noise(few, shape, fit, process_groups(base.alphabet), whole=runs, memories=memories)
    measured = well_known_locations(sha, shape, fit, base)
    if spread is None:
        machines = trace_machines(traces, temperature)
        spread = machine_spread(few, shape, fit, noise=noise, groups=process_groups(base.alphabet), machines=machines)
    learned = learned_sha(name, sha, shape=shape, fit=fit, noise=noise, spread=spread, runs=few, base=measured)
    model = Model(
        sha=with_range(learned, runs, 4.0 * noise.sensor),
        alphabet=base.alphabet,
        temperature=temperature,
        sensor_sigma=noise.sensor,
        sensor_memory=noise.sensor_memory,
        initial=initial_law(traces, temperature),
        borrowed=frozenset(
            each.name for each in learned.locations if parameter_source(each.name, measured).startswith("borrowed")
        ),
        unit=signal_unit(traces, temperature),
    )
    return _FittedCandidate(
        model=replace(model, semi_markov=fit_stays(model, traces)),
        values=stay_values(few, learned, shape=shape, fit=fit, noise=noise, base=measured),
        locations=location_fits(learned, shape, fit, runs, measured),
        fit=fit,
        noise=noise,
        spread=spread,
    )


def _held_out_forecasts(
    traces: Sequence[Trace],
    alphabet: Alphabet,
    temperature: str,
    *,
    candidate: BinsCandidate,
    whole: _FittedCandidate,
    seed: int,
) -> HeldOutForecasts:
    """Forecasts by models of the same kind, as random as the `whole` one, that did not see what came next.

    With six traces or more, each third of them is forecast by the model of the others; with fewer, the third and the
    last quarter of each trace's time by a model of the time before.
    """
    rng = np.random.default_rng(seed)
    forecasts = HeldOutForecasts(learn_plain(traces, temperature), seed)
    for part in splits(traces):
        forecasts.other_days = part.held is not None
        # A part of the data may teach nothing although the whole does: the other parts then judge alone.
        try:
            runs, base = _ground(part.known, alphabet, temperature)
        except LearningError:
            continue
        model = _fit_candidate(
            "part",
            part.known,
            runs=runs,
            base=base,
            candidate=candidate,
            begin=None,
            temperature=temperature,
            budget=PART_BUDGET,
            memories=whole.noise.memories,
            spread=whole.spread,
        ).model
        forecasts.add(model, part.ahead, part.since, rng)
    return forecasts
