"""Features of cycles, their law, and the error that goes with strangeness; judged by scikit-learn and known answers."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from sklearn.covariance import LedoitWolf
from sklearn.isotonic import IsotonicRegression

from gateway.outside.texts import all_words, strange_sentence
from sim.artefacts import FAMILIARITY_FILE, Familiarity, read_familiarity
from sim.familiarity import (
    COLUMNS,
    FEATURES,
    CyclePoint,
    CyclePoints,
    ExcessSoFar,
    GrowingCycle,
    PointSource,
    StrangeThing,
    cycle_points,
    error_curve,
    fit_reference,
    measured_classes,
    parse_curve,
    parse_reference,
    shrunk_covariance,
)
from sim.files import ArtefactError
from sim.lab.recordings import split_cycles
from sim.sha import DECANTER, Array, Encoder, Trace, encode

NAMES = list(COLUMNS)
SOURCE = PointSource(DECANTER, "T", {"feed": "TFango"})


def cycles(count: int, seed: int, **fixed: float) -> list[Array]:
    """Cycles of three points with loads in two groups, 120 or 240 A; other features scatter about their level.

    Nothing is known of their history, so that no temperature is expected.
    """
    rng = np.random.default_rng(seed)
    level = {"load": 180.0, "idling": 300.0, "temperature": 40.0, "feed": 25.0, "ambient": 20.0}
    made = []
    for number in range(count):
        points = np.full((3, len(NAMES)), np.nan)
        points[:, NAMES.index("age")] = 300.0
        for place, name in enumerate(FEATURES):
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
    assert curve.expected_error(9.0) == curve.error[-1]


def known_trace() -> Trace:
    """Ten minutes standing, forty idling at 60 A, ten at 150 A; it warms by 0.01 degC/s while it runs."""
    times = np.arange(0.0, 3600.0, 10.0)
    running = (times >= 600.0).astype(float)
    load = np.where(times < 600.0, 0.0, np.where(times < 3000.0, 60.0, 150.0))
    temperature = 20.0 + 0.01 * np.maximum(times - 600.0, 0.0)
    trace = Trace("known", times, {"MarciaDecanter": running, "Assorbimento": load, "T": temperature})
    return replace(trace, events=encode(trace, DECANTER))


def test_features_of_a_cycle_whose_course_is_known() -> None:
    trace = known_trace()
    points = cycle_points(trace, SOURCE, begin=600.0, end=float(trace.times[-1]))
    # Nine tenths of an hour have to have been read: the first points of the cycle say nothing.
    assert points.times.tolist() == [3300.0, 3590.0]
    last = dict(zip(NAMES, points.values[-1], strict=True))
    assert last["idling"] == pytest.approx(2400.0) and last["starts"] == 1 and last["age"] == 2990.0
    assert last["resting"] == pytest.approx(600.0, abs=15.0)
    assert last["peak"] == 150.0 and last["load"] == pytest.approx((1200 * 60 + 590 * 150) / 1790, rel=0.01)
    assert last["warming"] == pytest.approx(18.0, abs=0.2) and last["temperature"] == pytest.approx(49.9)
    assert last["dwell"] == pytest.approx(590.0) and np.isnan(last["feed"])
    assert last["temperature before"] == 20.0
    assert last["running an hour"] == pytest.approx(2990 / 3590, abs=0.005)
    # What it was at an earlier point does not depend on what came later.
    early = cycle_points(trace.between(0.0, 3301.0), SOURCE, begin=600.0, end=3300.0)
    assert early.values == pytest.approx(points.values[:1], nan_ok=True)


def restless(seed: int, hours: float = 12.0, step: float = 1.0, warmer: float = 0.0) -> Trace:
    """Runs and rests of drawn lengths under a drawn load, read every `step` s with gaps; the bearing follows both.

    `warmer` is by how much (degC) the running bearing ends above that of another machine.
    """
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, hours * 3600.0, step)
    running, load = np.zeros(times.size), np.zeros(times.size)
    at = 0
    while at < times.size:
        rest, run = (int(rng.uniform(*span) / step) for span in ((900, 2400), (3000, 6000)))
        running[at + rest : at + rest + run] = 1.0
        at += rest + run
    levels = rng.uniform(80.0, 300.0, times.size // 600 + 1)
    load = running * (np.repeat(levels, 600)[: times.size] + rng.normal(0.0, 5.0, times.size))
    target = np.where(running > 0, 30.0 + 0.1 * load + warmer, 20.0)
    keep = np.exp(-step / 1200.0)
    temperature = lfilter([1 - keep], [1.0, -keep], target, zi=[keep * 20.0])[0] + rng.normal(0.0, 0.1, times.size)
    kept = (rng.random(times.size) > 0.02) & ~((times > 20_000.0) & (times < 20_100.0))
    signals = {"MarciaDecanter": running, "Assorbimento": load, "T": temperature, "TFango": 15.0 + 0.0 * times}
    trace = Trace("restless", times[kept], {name: column[kept] for name, column in signals.items()})
    return replace(trace, events=encode(trace, DECANTER))


def cycles_of(trace: Trace) -> list[CyclePoints]:
    """The points of each cycle of a trace, its last one too."""
    pieces = split_cycles(trace, DECANTER, gap=DECANTER.gap)
    return [cycle_points(trace, SOURCE, begin=float(piece.times[0]), end=float(piece.times[-1])) for piece in pieces]


@pytest.mark.parametrize("step", [0.5, 1.0, 7.0])
def test_a_growing_cycle_has_the_points_of_the_whole_one_to_its_end(step: float) -> None:
    trace = restless(1, hours=8.0, step=step)
    pieces = [piece for piece in split_cycles(trace, DECANTER, gap=DECANTER.gap) if piece.times.size]
    begins = {float(piece.times[0]) for piece in pieces}
    encoder, growing = Encoder(DECANTER), GrowingCycle(SOURCE)
    found: dict[float, list[CyclePoint]] = {begin: [] for begin in begins}
    rows = zip(trace.times.tolist(), *(trace.signals[name].tolist() for name in trace.signals), strict=True)
    for time, *values in rows:
        readings = dict(zip(trace.signals, values, strict=True))
        events = encoder.feed(time, {name: readings[name] for name in ("MarciaDecanter", "Assorbimento")})
        before = growing.at_end() if time in begins else None
        point = growing.take(time, readings.get, events)
        for each in (point, before):
            if each is not None and each.values is not None and each not in found[each.begin]:
                found[each.begin].append(each)
    found[max(begins)].append(growing.at_end())  # type: ignore[arg-type]
    points = 0
    for piece in pieces:
        begin, end = float(piece.times[0]), float(piece.times[-1])
        whole, grown = cycle_points(trace, SOURCE, begin=begin, end=end), found[begin]
        # The growing one cannot know that a gap follows: it may have one more, of the time without readings.
        assert [each.time for each in grown if each.time <= end] == pytest.approx(whole.times.tolist())
        for each, values in zip((each for each in grown if each.time <= end), whole.values, strict=True):
            assert each.values == pytest.approx(values, rel=1e-9, nan_ok=True)
        points += len(whole.times)
    assert len(pieces) >= 5 and points > 60


def test_a_growing_cycle_keeps_an_hour_at_most_and_begins_anew_when_the_clock_is_set_back() -> None:
    growing, encoder = GrowingCycle(SOURCE), Encoder(DECANTER)
    for second in range(20_000):
        readings = {"MarciaDecanter": 1.0, "Assorbimento": 150.0, "T": 40.0}
        growing.take(second / 2, readings.get, encoder.feed(second / 2, {"MarciaDecanter": 1.0, "Assorbimento": 150.0}))
    assert growing.row_count <= 363 and growing.begin == 0.0
    assert growing.take(5.0, readings.get, []) is None and growing.begin is None and growing.row_count == 1


def test_the_same_machine_is_familiar_and_a_warmer_one_is_not_at_every_age() -> None:
    training = [each.values for seed in range(10) for each in cycles_of(restless(seed, step=10.0))]
    reference = fit_reference(training)
    same = [each for seed in range(31, 37) for each in cycles_of(restless(seed, step=10.0)) if len(each.times)]
    other = [each for seed in (41, 42) for each in cycles_of(restless(seed, step=10.0, warmer=6.0)) if len(each.times)]
    assert np.mean([reference.strangeness(each.values, each.times).value > 1.2 for each in same]) <= 0.05
    found = [reference.strangeness(each.values, each.times) for each in other]
    assert all(each.value > 1.2 for each in found)
    assert {each.thing.kind for each in found} == {"warmer"}
    # Point for point it is the same, whether the cycle is whole or grows.
    for cycle in (*same[:5], *other[:5]):
        so_far, worst = ExcessSoFar(), 0.0
        for time, point in zip(cycle.times.tolist(), cycle.values, strict=True):
            rated, so_far = reference.follow(point, time, so_far)
            worst = max(worst, rated.value)
        assert worst == pytest.approx(reference.strangeness(cycle.values, cycle.times).value, rel=1e-9)


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
    assert found.thing.kind == "above" and found.thing.features == ("idling",)
    sentences = {language: strange_sentence(words, found.thing) for language, words in all_words().items()}
    assert sentences["en"].startswith("idling for 57 min of the last hour: in training at most ")
    assert sentences["it"].startswith("a vuoto per 57 min dell'ultima ora: nell'addestramento al massimo ")
    assert sentences["de"].startswith("Leerlauf über 57 min der letzten Stunde: im Training höchstens ")


def test_what_lies_between_the_kinds_of_cycles_is_strange_by_its_density_alone() -> None:
    reference = fit_reference(cycles(80, 1))
    middle = np.vstack(cycles(40, 4)).mean(axis=0, keepdims=True)
    far, rare = reference.distances(middle)[:, :2].T
    own_far, own_rare = reference.distances(np.vstack(cycles(40, 5)))[:, :2].T
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
    assert by_machine.scales[0, 0] > 1.05 * by_cycle.scales[0, 0]


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


def test_every_strange_thing_has_a_sentence_in_every_language() -> None:
    things = [StrangeThing("above", (name,), (1.0,), 2.0) for name in FEATURES]
    things += [StrangeThing("together", ("load", "feed"), (1.0, 2.0)), StrangeThing("colder", (), (3.25,))]
    for words in all_words().values():
        assert all(strange_sentence(words, thing) for thing in things) and not strange_sentence(words, StrangeThing())
    assert strange_sentence(all_words()["it"], things[-1]).startswith("3,2 °C più freddo")


def test_too_few_cycles_and_unknown_features_are_refused() -> None:
    with pytest.raises(ValueError, match="7 cycles do not tell what is usual"):
        fit_reference(cycles(7, 1))
    plain = fit_reference(cycles(8, 1)).as_plain()
    with pytest.raises(ValueError, match="'magic' is unknown"):
        parse_reference(plain | {"features": ["magic"]})
    with pytest.raises(ValueError, match="as many errors"):
        parse_curve({"strangeness": [1.0], "error": [], "cycles": 1})
