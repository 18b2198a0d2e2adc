"""Features of cycles, their law, and the error that goes with strangeness; judged by scikit-learn and known answers."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sklearn.covariance import LedoitWolf
from sklearn.isotonic import IsotonicRegression

from sim.artefacts import FAMILIARITY_FILE, Familiarity, read_familiarity
from sim.familiarity import (
    FEATURES,
    cycle_points,
    error_curve,
    fit_reference,
    measured_classes,
    parse_curve,
    parse_reference,
    shrunk_covariance,
)
from sim.files import ArtefactError
from sim.sha import DECANTER, Array, Trace, encode

NAMES = list(FEATURES)


def cycles(count: int, seed: int, **fixed: float) -> list[Array]:
    """Cycles of three points with loads in two groups, 120 or 240 A; other features scatter about their level."""
    rng = np.random.default_rng(seed)
    level = {"load": 180.0, "idling": 300.0, "temperature": 40.0, "feed": 25.0, "ambient": 20.0}
    made = []
    for number in range(count):
        points = np.zeros((3, len(NAMES)))
        for place, name in enumerate(NAMES):
            feature = FEATURES[name]
            points[:, place] = level.get(name, 10.0 * feature.least) + 3.0 * feature.least * rng.normal(size=3)
        points[:, NAMES.index("load")] = (120.0 if number % 2 else 240.0) + 5.0 * rng.normal(size=3)
        for name, value in fixed.items():
            points[:, NAMES.index(name)] = value
        made.append(points)
    return made


def test_the_shrunk_covariance_and_the_curve_are_those_of_scikit_learn() -> None:
    rng = np.random.default_rng(0)
    z = rng.normal(size=(40, 6)) @ rng.normal(size=(6, 6))
    assert shrunk_covariance(z) == pytest.approx(LedoitWolf().fit(z).covariance_, rel=1e-12)
    x, y = rng.random(50), rng.random(50)
    curve = error_curve(x.tolist(), y.tolist())
    assert curve.error == pytest.approx(IsotonicRegression().fit(x, y).predict(np.sort(x)), rel=1e-12)
    assert curve.expected(9.0) == curve.error[-1]


def test_features_of_a_cycle_whose_course_is_known() -> None:
    """Ten minutes standing, forty idling at 60 A, ten at 150 A; the temperature rises by 0.01 degC/s while it runs."""
    times = np.arange(0.0, 3600.0, 10.0)
    running = (times >= 600.0).astype(float)
    load = np.where(times < 600.0, 0.0, np.where(times < 3000.0, 60.0, 150.0))
    temperature = 20.0 + 0.01 * np.maximum(times - 600.0, 0.0)
    signals = {"MarciaDecanter": running, "Assorbimento": load, "T": temperature}
    trace = Trace("known", times, signals)
    trace = replace(trace, events=encode(trace, DECANTER))
    points = cycle_points(trace, DECANTER, "T", {"feed": "TFango"}, begin=600.0, end=float(times[-1]))
    assert points.times[:2].tolist() == [900.0, 1200.0] and points.times[-1] == times[-1]
    last = dict(zip(NAMES, points.values[-1], strict=True))
    assert last["idling"] == pytest.approx(2400.0) and last["starts"] == 1
    assert last["resting"] == pytest.approx(600.0, abs=15.0)
    assert last["peak"] == 150.0 and last["load"] == pytest.approx((1200 * 60 + 590 * 150) / 1790, rel=0.01)
    assert last["warming"] == pytest.approx(18.0, abs=0.2) and last["temperature"] == pytest.approx(49.9)
    assert last["dwell"] == pytest.approx(590.0) and np.isnan(last["feed"])
    # What it was at an earlier point does not depend on what came later.
    early = cycle_points(trace.between(0.0, 1201.0), DECANTER, "T", {}, begin=600.0, end=1200.0)
    assert early.values[:-1] == pytest.approx(points.values[:1], nan_ok=True)


def test_ordinary_cycles_are_not_strange_and_strange_ones_are_named() -> None:
    reference = fit_reference(cycles(60, 1))
    times = np.arange(3.0)
    fresh = [reference.strangeness(points, times) for points in cycles(200, 2)]
    assert np.mean([each.value > 1.0 for each in fresh]) < 0.12
    # The p-values of ordinary cycles are about even: that is what calibrating on cycles held out is for.
    assert np.mean([each.p for each in fresh]) == pytest.approx(0.5, abs=0.1)
    (idle,) = cycles(1, 3, idling=3420.0)
    found = reference.strangeness(idle, times)
    assert found.value > 1.0 and found.p == pytest.approx(1 / 61)
    assert found.words.startswith("idling for 57 min of the last hour: in training at most ")


def test_what_lies_between_the_kinds_of_cycles_is_strange_by_its_density_alone() -> None:
    reference = fit_reference(cycles(80, 1))
    middle = np.vstack(cycles(40, 4)).mean(axis=0, keepdims=True)
    far, rare = reference.distances(middle[:, [NAMES.index(name) for name in reference.features]])
    usual = np.vstack(cycles(40, 5))
    own_far, own_rare = reference.distances(usual[:, [NAMES.index(name) for name in reference.features]])
    # Of all others every feature is at its mean there, and still it is farther from the crowd than from the mean.
    assert far[0] / np.median(own_far) < rare[0] / np.median(own_rare)


def test_a_feature_that_is_not_measured_counts_for_nothing() -> None:
    training = cycles(20, 1)
    for points in training:
        points[:, NAMES.index("feed")] = np.nan
    reference = fit_reference(training)
    assert "feed" not in reference.features
    (one,) = cycles(1, 2)
    plain = reference.strangeness(one, np.arange(3.0))
    one[:, NAMES.index("feed")] = 99.0
    assert reference.strangeness(one, np.arange(3.0)) == plain


def test_machines_are_held_out_where_there_are_three() -> None:
    groups = [cycles(12, 1, ambient=5.0), cycles(12, 2, ambient=20.0), cycles(12, 3, ambient=35.0)]
    names = [name for name in "abc" for _ in range(12)]
    by_machine = fit_reference([each for group in groups for each in group], names)
    by_cycle = fit_reference([each for group in groups for each in group])
    assert by_machine.distance > 1.05 * by_cycle.distance


def test_classes_are_judged_by_the_curve_of_the_other_cycles() -> None:
    pairs = [(0.5, 0.1), (0.6, 0.2), (1.5, 0.44), (1.6, 0.46), (3.0, 0.9), (3.1, 0.8)]
    green, yellow, red = measured_classes(pairs)
    assert (green.name, green.cycles, yellow.cycles, red.cycles) == ("green", 2, 2, 2)
    assert green.error == pytest.approx(0.15) and red.error == pytest.approx(0.85)


def test_the_file_of_a_model_goes_there_and_back_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    assert read_familiarity(tmp_path) is None
    reference, curve = fit_reference(cycles(12, 1)), error_curve([0.5, 1.0], [0.1, 0.2])
    (tmp_path / FAMILIARITY_FILE).write_text(Familiarity(reference, curve).text(), encoding="utf-8")
    back = read_familiarity(tmp_path)
    assert back is not None and back.curve is not None and back.curve.as_plain() == curve.as_plain()
    points, times = cycles(1, 9)[0], np.arange(3.0)
    assert back.reference.strangeness(points, times) == reference.strangeness(points, times)
    plain = json.loads(Familiarity(reference, None).text())
    plain["reference"]["mean"] = [1.0]
    (tmp_path / FAMILIARITY_FILE).write_text(json.dumps(plain), encoding="utf-8")
    with pytest.raises(ArtefactError, match=r"familiarity\.json: cannot be used"):
        read_familiarity(tmp_path)


def test_too_few_cycles_and_unknown_features_are_refused() -> None:
    with pytest.raises(ValueError, match="7 cycles do not tell what is usual"):
        fit_reference(cycles(7, 1))
    plain = fit_reference(cycles(8, 1)).as_plain()
    with pytest.raises(ValueError, match="'magic' is unknown"):
        parse_reference(plain | {"features": ["magic"]})
    with pytest.raises(ValueError, match="as many errors"):
        parse_curve({"strangeness": [1.0], "error": [], "cycles": 1})
