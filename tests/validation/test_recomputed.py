"""Every figure of a campaign's CSV once more, from the traces and the model's numbers alone, with nothing of ours."""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import replace
from io import StringIO
from itertools import product
from math import ceil, log10, sqrt
from pathlib import Path

import numpy as np
import pytest

from sim.lab.formats.find import FoundModel
from sim.lab.judge.campaign import local_runner, outcomes_by_model
from sim.lab.judge.discovery import Discovery
from sim.lab.judge.free_run import TraceRunSettings
from sim.lab.judge.output_folder import results_csv
from sim.lab.judge.ranking import rank
from sim.lab.judge.results import TraceResult
from sim.lab.judge.stages import Prepared
from sim.sha.trace import Array, Trace
from tests.validation.small_plant import COLD, HOT, K, plant_model, plant_trace

SPREAD = {"sharp": (0.0, 0.0), "wide": (3.0, 0.1), "shifted": (3.0, 0.1)}
"""Sigma of the mode parameter (degC) and noise of the flow, by model."""
OFFSET = {"sharp": 0.0, "wide": 0.0, "shifted": 0.6}
"""How much too high a model's targets are, degC."""
SENSOR = 0.3


def drifting(number: int) -> Trace:
    """A trace whose error wanders: neighbouring readings are alike, as those of a plant are."""
    trace = plant_trace(f"run{number}", rows=260 + 17 * number, noise=0.2, seed=number)
    steps = np.random.default_rng(100 + number).normal(scale=0.6, size=trace.times.size)
    wander = np.zeros(steps.size)
    for row in range(1, steps.size):
        wander[row] = 0.9 * wander[row - 1] + steps[row]
    values = trace.signals["T"] + wander
    return replace(trace, signals={**trace.signals, "T": values})


TRACES = [drifting(number) for number in range(8)]


def prepared(label: str) -> Prepared:
    sigma, noise = SPREAD[label]
    model = plant_model(label, SENSOR, sigma, noise)
    places = tuple(
        replace(
            place,
            distribution=replace(place.distribution, params={"mu": mu + OFFSET[label], "sigma": sigma}),
        )
        for place, mu in zip(model.sha.locations, (COLD, HOT), strict=True)
        if place.distribution is not None
    )
    model = replace(model, sha=replace(model.sha, locations=places))
    return Prepared(
        label=label,
        where=label,
        parsed=FoundModel(label, model.sha, model),
        structure=model,
        variants={"carried": model},
        refusals={},
        stages=(),
        discovery=Discovery("", Path(), ()),
    )


@pytest.fixture(scope="module")
def results() -> list[TraceResult]:
    models = [prepared(label) for label in SPREAD]
    found = outcomes_by_model(
        models,
        TRACES,
        without=(),
        settings=TraceRunSettings(4000),
        run=local_runner(1),
        progress=lambda _what, _share: None,
    )
    return [outcome.result for _, outcomes in found for outcome in outcomes]


@pytest.fixture(scope="module")
def rows(results: list[TraceResult]) -> dict[tuple[str, str], dict[str, str]]:
    return {(row["model"], row["trace"]): row for row in csv.DictReader(StringIO(results_csv(results)))}


Rows = Mapping[tuple[str, str], Mapping[str, str]]


def number(rows: Rows, model: str, trace: str, name: str) -> float:
    return float(rows[model, trace][name])


def mean_course(model: str, trace: Trace) -> Array:
    """From the first reading on: each second towards the target of the motor's state."""
    targets = np.where(trace.signals["Motor"] > 0, HOT, COLD) + OFFSET[model]
    course = [float(trace.signals["T"][0])]
    for target in targets[:-1]:
        course.append(target + (course[-1] - target) * np.exp(-K))
    return np.array(course)


def simulated(model: str, trace: Trace, runs: int = 4000) -> Array:
    """(rows, runs) temperatures as the sensor would read them; a target is drawn whenever the motor changes."""
    sigma, noise = SPREAD[model]
    rng = np.random.default_rng(7)
    x, course, before = np.full(runs, trace.signals["T"][0]), [], None
    for motor in trace.signals["Motor"]:
        course.append(x + SENSOR * rng.normal(size=runs))
        if motor != before:
            target = (HOT if motor else COLD) + OFFSET[model] + sigma * rng.normal(size=runs)
        before = motor
        x = target + (x - target) * np.exp(-K)
        x = x + noise * sqrt((1 - np.exp(-2 * K)) / (2 * K)) * rng.normal(size=runs)
    return np.array(course)


@pytest.mark.parametrize("model", SPREAD)
def test_errors_are_to_the_last_digits_those_of_the_recursion_written_down(model: str, rows: Rows) -> None:
    for trace in TRACES:
        measured = trace.signals["T"]
        error = mean_course(model, trace) - measured
        changes = np.flatnonzero(np.diff(trace.signals["Motor"], prepend=-1.0))
        expected = {
            "mae": np.abs(error).mean(),
            "rmse": sqrt(np.mean(error**2)),
            "at_samples_mae": np.abs(error).mean(),
            "dense_rmse": sqrt(np.mean(error**2)),
            "at_events_mae": np.abs(error[changes]).mean(),
            "at_events_count": changes.size,
            "final_error": error[-1],
            "final_percent": 100 * abs(error[-1]) / abs(measured[-1]),
            "max_error": np.abs(error).max(),
            "error_sigma": error.std(),
            "persistence": np.abs(measured - measured[0]).mean(),
            "duration": trace.times[-1] - trace.times[0],
        }
        found = {name: number(rows, model, trace.name, name) for name in expected}
        assert found == pytest.approx(expected, rel=1e-9)
        quantiles = [float(word) for word in rows[model, trace.name]["error_quantiles"].split("; ")]
        assert quantiles == pytest.approx(np.percentile(error, [0, 5, 25, 50, 75, 95, 100]).tolist(), rel=1e-9)


def test_coverage_and_crps_are_those_of_runs_of_our_own(rows: Rows) -> None:
    for model in ("wide", "shifted"):
        for trace in TRACES[:3]:
            runs, measured = simulated(model, trace), trace.signals["T"]
            low, high = np.percentile(runs, [5, 95], axis=1)
            inside = np.mean((measured >= low) & (measured <= high))
            pairs = np.abs(runs[:, 1::2] - runs[:, ::2]).mean(axis=1)  # E|X - X'| of independent pairs
            crps = (np.abs(runs - measured[:, None]).mean(axis=1) - pairs / 2).mean()
            beyond = np.mean(np.abs(measured - runs.mean(axis=1)) > 3 * runs.std(axis=1))
            assert number(rows, model, trace.name, "coverage") == pytest.approx(inside, abs=0.03)
            assert number(rows, model, trace.name, "crps") == pytest.approx(crps, rel=0.03)
            assert number(rows, model, trace.name, "beyond") == pytest.approx(beyond, abs=0.03)


def block_of(series: Array) -> int:
    """Politis & White (2004) with the correction of 2009, summed term by term."""
    n, centred = series.size, series - series.mean()
    rho = [float(centred[: n - lag] @ centred[lag:] / (centred @ centred)) for lag in range(n // 2 + 1)]
    bound, run = 2 * sqrt(log10(n) / n), max(5, ceil(sqrt(log10(n))))
    last = next(lag for lag in range(n // 2) if all(abs(r) < bound for r in rho[lag + 1 : lag + 1 + run]))
    reach = 2 * last
    window = {lag: min(1.0, 2 * (1 - lag / reach)) for lag in range(1, reach + 1)}
    slope = 2 * sum(weight * lag * rho[lag] for lag, weight in window.items())
    level = 1 + 2 * sum(weight * rho[lag] for lag, weight in window.items())
    return min(ceil((2 * slope**2 / (4 / 3 * level**2) * n) ** (1 / 3)), n // 3)


def interval_of(series: Array, block: int, rng: np.random.Generator) -> Array:
    """Circular blocks laid end to end until there are as many values as before; percentiles of their means."""
    n, circle = series.size, np.concatenate([series, series])
    means = []
    for _ in range(4000):
        starts = rng.integers(n, size=ceil(n / block))
        means.append(np.concatenate([circle[start : start + block] for start in starts])[:n].mean())
    return np.percentile(means, [2.5, 97.5])


def test_intervals_are_those_of_a_block_bootstrap_of_our_own(rows: Rows) -> None:
    rng = np.random.default_rng(3)
    for trace in TRACES[:4]:
        error = mean_course("wide", trace) - trace.signals["T"]
        for name, series, back in (("mae", np.abs(error), lambda x: x), ("rmse", error**2, np.sqrt)):
            low, high = back(interval_of(series, block_of(series), rng))
            found = [number(rows, "wide", trace.name, f"{name}_{end}") for end in ("low", "high")]
            assert found == pytest.approx([low, high], abs=0.1 * (high - low))


def scores(rows: Rows) -> dict[str, Array]:
    """S by model, trace by trace, from the columns of the CSV."""
    columns = (("mae", 0.5), ("max_error", 0.3), ("error_sigma", 0.2))
    return {
        model: np.array([sum(w * number(rows, model, trace.name, name) for name, w in columns) for trace in TRACES])
        for model in SPREAD
    }


def signed_rank(differences: Sequence[float]) -> float:
    """Wilcoxon's two-sided p by all 2^n signs."""
    ranks = 1 + np.argsort(np.argsort(np.abs(differences)))
    centre = ranks.sum() / 2
    seen = abs(ranks[np.array(differences) > 0].sum() - centre)
    sums = [ranks[list(signs)].sum() for signs in product((False, True), repeat=len(differences))]
    return float(np.mean([abs(total - centre) >= seen for total in sums]))


def test_scores_wins_and_paired_tests_are_those_of_the_csv(results: list[TraceResult], rows: Rows) -> None:
    found, own = rank(results), scores(rows)
    assert own["sharp"] == pytest.approx(own["wide"], rel=1e-12)  # they have one mean course, and share their wins
    better = int(np.sum(own["shifted"] < own["wide"]))
    assert 0 < better < len(TRACES)
    for one in found.standings:
        assert one.score == pytest.approx(own[one.entrant].mean(), rel=1e-12)
        assert one.wins == (better if one.entrant == "shifted" else (len(TRACES) - better) / 2)
    for pair in found.pairs:
        differences = own[pair.one] - own[pair.other]
        told = "shifted" in (pair.one, pair.other)
        p = signed_rank(differences) if told else 1.0
        assert pair.difference.mean == pytest.approx(differences.mean(), abs=1e-12)
        assert pair.difference.p == pytest.approx(p, abs=1e-12)
        assert pair.p == pytest.approx(min(1.0, 3 * p), abs=1e-12)  # Holm: two equal ones of three pairs
        means = np.random.default_rng(5).choice(differences, (20_000, differences.size)).mean(axis=1)
        low, high = np.percentile(means, [2.5, 97.5])
        assert [pair.difference.low, pair.difference.high] == pytest.approx(
            [low, high], abs=0.06 * (high - low) + 1e-12
        )
