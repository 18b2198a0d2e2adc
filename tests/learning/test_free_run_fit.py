"""The free-run fitter on known truths: exact without noise, honest errors with it, unmoved by spikes and gaps."""

from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np
import pytest

from sim.lab.learning.bins.candidates import BinsCandidate, build, build_basis
from sim.lab.learning.data import resolution, without_spikes
from sim.lab.learning.free_run import FreeRunFit, fit_free_run, predict
from sim.lab.learning.refit import refit
from sim.lab.learning.runs import FreeRuns, free_runs, pieces, sample_runs, thin_free_runs, thin_runs
from sim.lab.learning.structure import LearningError, bare_sha
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import DECANTER, encode
from sim.sha.trace import UNKNOWN, Event, Trace
from tests.learning.plants import Truth, simulate, with_signal, without_rows

EXACT = Truth(noise=0.0, scatter=0.0, sensor=0.0, gain=0.1, tau=(700.0, 500.0))
DRIVEN = BinsCandidate("driven", "switch", "shared")


def runs_of(traces: list[Trace]) -> FreeRuns:
    return free_runs(traces, bare_sha(DECANTER), "T", signals=("Assorbimento",), rising="W_ON")


def fitted(runs: FreeRuns, candidate: BinsCandidate = DRIVEN) -> tuple[dict[str, float], FreeRunFit]:
    _, shape, names = build(candidate, build_basis(runs, DECANTER))
    fit = fit_free_run(runs, shape)
    values = dict(zip(names.targets, fit.linear, strict=False))
    values |= {f"gain {group}": fit.linear[len(names.targets) + n] for n, (group, _) in enumerate(names.gains)}
    return values | {f"tau {group}": 1 / rate for group, rate in zip(names.rates, fit.rates, strict=True)}, fit


def assert_exact(values: dict[str, float]) -> None:
    targets = [values[name] for name in ("OFF/0-100", "ON/0-100", "ON/100-200", "ON/200-300", "ON/300+")]
    np.testing.assert_allclose(targets, EXACT.targets, atol=0.1)
    assert values["tau OFF"] == pytest.approx(700, rel=0.01)
    assert values["tau ON"] == pytest.approx(500, rel=0.01)
    assert values["gain all"] == pytest.approx(0.1, rel=0.02)


def test_without_noise_targets_rates_gain_and_start_temperatures_come_back() -> None:
    traces = simulate(EXACT, 1, cycles=4)
    values, fit = fitted(runs_of(traces))
    assert_exact(values)
    np.testing.assert_allclose(fit.start, [trace.signals["T"][0] for trace in traces], atol=0.05)


def test_missing_readings_and_repeated_timestamps_change_nothing() -> None:
    rng = np.random.default_rng(3)
    traces = []
    for trace in simulate(EXACT, 2, cycles=4):
        twice = np.sort(np.concatenate([np.arange(trace.times.size), np.arange(0, trace.times.size, 9)]))
        again = without_rows(trace, twice)
        holes = np.where(rng.random(again.times.size) < 0.6, np.nan, again.signals["T"])
        current = np.where(
            np.diff(again.signals["Assorbimento"], prepend=np.nan) == 0, np.nan, again.signals["Assorbimento"]
        )
        traces.append(with_signal(again, T=holes, Assorbimento=current))
    assert_exact(fitted(runs_of(traces))[0])


def test_a_gap_ends_the_run_and_a_new_start_temperature_begins() -> None:
    trace = simulate(EXACT, 4, cycles=1)[0]
    rows = np.arange(trace.times.size)
    gap = without_rows(trace, (rows < 100) | (rows > 130))
    jumped = with_signal(gap, T=np.where(gap.times > trace.times[115], gap.signals["T"] + 10.0, gap.signals["T"]))
    runs = runs_of([jumped])
    assert np.unique(runs.run).size == 2
    begins = runs.time[runs.first]
    assert begins[1] > trace.times[130]
    _, fit = fitted(runs)
    np.testing.assert_allclose(fit.start, runs.reading[runs.first], atol=1.0)


def test_no_step_is_made_through_an_unknown_stretch() -> None:
    trace = simulate(EXACT, 4, cycles=1)[0]
    blind = replace(
        trace, events=(*(e for e in trace.events if e.time < trace.times[50]), Event(trace.times[50], UNKNOWN))
    )
    runs = runs_of([blind])
    assert runs.time[-1] <= trace.times[50]


def test_a_start_up_begins_a_new_run_only_after_a_whole_cycle() -> None:
    trace = simulate(EXACT, 5, cycles=1, rows=600)[0]
    running = ((np.arange(600) // 50) % 2).astype(float)
    toggled = with_signal(trace, MarciaDecanter=running)
    sha = bare_sha(DECANTER)
    begins = {c: free_runs([toggled], sha, "T", rising="W_ON", cycle=c).first.sum() for c in (0.0, 1500.0, 1e9)}
    starts = sum(event.symbol == "W_ON" for event in toggled.events)
    assert begins[0.0] == starts + 1
    assert begins[1e9] == 1
    assert 1 < begins[1500.0] < starts


def test_merged_steps_give_the_same_free_run_where_inputs_are_steady() -> None:
    trace = simulate(replace(EXACT, gain=0.0), 6, cycles=1, rows=600, period=2.0)[0]
    runs = runs_of([trace])
    few = thin_runs(runs, 150)
    assert len(few) < 220
    assert few.dt.sum() == pytest.approx(runs.dt.sum())
    values, _ = fitted(runs, BinsCandidate("constant", "switch"))
    fewer, _ = fitted(few, BinsCandidate("constant", "switch"))
    assert fewer["tau ON"] == pytest.approx(values["tau ON"], rel=0.02)


@pytest.mark.parametrize("budget", [150, 10_000])
def test_traces_thinned_one_by_one_are_those_thinned_together(budget: int) -> None:
    traces = [
        replace(trace, times=trace.times + 1e6 * number)
        for number, trace in enumerate(simulate(EXACT, 6, cycles=3, rows=400, period=2.0))
    ]
    traces = [replace(trace, events=encode(trace, DECANTER)) for trace in traces]
    sha = bare_sha(DECANTER)
    together = thin_runs(free_runs(traces, sha, "T", signals=["Assorbimento"]), budget)
    apart = thin_free_runs(traces, sha, "T", budget, signals=["Assorbimento"])
    for each in fields(FreeRuns):
        np.testing.assert_array_equal(getattr(apart, each.name), getattr(together, each.name))


def test_too_many_changes_are_sampled_in_windows_that_span_the_whole_time() -> None:
    trace = simulate(EXACT, 7, cycles=1, rows=3000, hold=1)[0]
    runs = runs_of([trace])
    few = sample_runs(runs, 400)
    assert len(few) < 600
    assert few.time[-1] - few.time[0] > 0.9 * (runs.time[-1] - runs.time[0])
    assert np.all(few.dt[few.first] == 0)
    assert np.all(np.isfinite(few.reading[few.first]))


def test_pieces_are_whole_steps_of_one_run_each() -> None:
    runs = runs_of(simulate(EXACT, 8, cycles=2))
    cut = pieces(runs, 7)
    assert np.unique(cut.run).size == 7
    assert np.all(np.isfinite(cut.reading[cut.first]))
    assert len(cut) == len(runs)


@pytest.mark.parametrize("seed", range(3))
def test_spikes_do_not_move_the_fit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    traces = []
    for trace in simulate(Truth(gain=0.1, scatter=0.0), seed, cycles=6):
        spiked = np.where(rng.random(trace.times.size) < 0.03, 0.0, trace.signals["T"])
        traces.append(with_signal(trace, T=spiked))
    values, fit = fitted(runs_of(traces))
    assert abs(values["ON/200-300"] - 65) < 1.0
    assert values["tau all" if "tau all" in values else "tau ON"] == pytest.approx(600, rel=0.1)
    assert fit.sigma < 0.5


def test_lasting_outliers_are_held_down_by_the_loss_and_not_by_squares() -> None:
    trace = simulate(Truth(scatter=0.0), 9, cycles=4)
    stuck = [with_signal(one, T=np.where((np.arange(240) % 60) < 6, 5.0, one.signals["T"])) for one in trace]
    runs = runs_of(stuck)
    _, shape, _ = build(BinsCandidate("constant", "shared"), build_basis(runs, DECANTER))
    truth = np.array([20.0, 35.0, 50.0, 65.0, 80.0])
    robust = np.abs(fit_free_run(runs, shape).linear - truth).max()
    squares = np.abs(fit_free_run(runs, shape, loss="squares").linear - truth).max()
    assert robust < 3.0 < squares


def test_standard_errors_cover_the_truth() -> None:
    z = []
    for seed in range(12):
        _, fit = fitted(runs_of(simulate(Truth(), seed, cycles=8)), BinsCandidate("constant", "shared"))
        z += ((fit.linear - np.array(Truth().targets)) / fit.errors[:5]).tolist()
        z.append(float(np.log(fit.rates[0] * 600) / fit.errors[5]))
    # 72 values, some of them related: between 80 and 100 % within two standard errors, none beyond five.
    assert np.mean(np.abs(z) < 2) > 0.8
    assert np.max(np.abs(z)) < 5


def test_held_out_prediction_uses_the_given_parameters() -> None:
    traces = simulate(EXACT, 10, cycles=4)
    known = runs_of(traces[:3])
    _, shape, _ = build(DRIVEN, build_basis(known, DECANTER))
    fit = fit_free_run(known, shape)
    ahead = runs_of(traces[3:])
    np.testing.assert_allclose(predict(ahead, shape, fit.linear, fit.rates, 0.1), ahead.reading, atol=0.2)


def test_spikes_are_set_aside_and_jumps_are_kept() -> None:
    rng = np.random.default_rng(0)
    x = 20 + rng.normal(0, 0.1, 300)
    x[150:] += 5.0
    x[[40, 200]] += 30.0
    cleaned = without_spikes(x, 0.0)
    assert np.isnan(cleaned[[40, 200]]).all()
    assert np.isnan(cleaned).sum() <= 4
    assert np.isfinite(cleaned[145:155]).all()


def test_resolution_is_the_step_of_a_rounded_sensor() -> None:
    x = np.round(np.linspace(20, 30, 500), 1)
    assert resolution(x) == pytest.approx(0.1)
    assert resolution(np.full(5, 3.0)) == 0.0


def two_flows(kind: str, params: dict[str, float]) -> SHA:
    law = Distribution("normal", {"mu": 0.0, "sigma": 1.0})
    still = Location("rest", Flow("constant", {"noise": 0.0}), entry="none")
    return SHA("two", (still, Location("go", Flow(kind, params), law)), (Edge("rest", "GO", "go"),), "rest")


@pytest.mark.parametrize(
    ("kind", "params", "course", "m", "rate"),
    [
        ("linear", {"noise": 0.0}, lambda u: 0.01 * u, 0.01, None),
        ("logarithmic", {"t0": 100.0, "noise": 0.0}, lambda u: 3.0 * np.log((60.0 + u) / 60.0), 3.0, 60.0),
        ("exponential", {"k": 0.01, "noise": 0.0}, lambda u: 30 * (1 - np.exp(-u / 300)), 50.0, 1 / 300),
    ],
)
def test_any_automaton_can_be_refitted(
    kind: str, params: dict[str, float], course: Callable[[np.ndarray], np.ndarray], m: float, rate: float | None
) -> None:
    times = np.arange(0.0, 2000.0, 5.0)
    trace = Trace("t", times, {"T": 20.0 + course(times)}, events=(Event(0.0, "GO"),))
    found = refit(two_flows(kind, params), [trace], "T")
    go = found.sha.by_name["go"]
    assert go.distribution is not None
    assert go.distribution.params["mu"] == pytest.approx(m, rel=0.02)
    if rate is not None:
        assert go.flow.params["t0" if kind == "logarithmic" else "k"] == pytest.approx(rate, rel=0.05)


def test_a_trace_that_the_automaton_cannot_follow_is_refused_by_name() -> None:
    trace = Trace("odd", np.arange(10.0), {"T": np.arange(10.0)}, events=(Event(0.0, "STOP"),))
    with pytest.raises(LearningError, match=r"trace 'odd': event 0 \('STOP'\) has no edge from location 'rest'"):
        refit(two_flows("linear", {"noise": 0.0}), [trace], "T")
