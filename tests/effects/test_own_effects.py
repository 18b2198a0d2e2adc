"""An engineer's own effect, one line of TOML: every engine takes it from there, and what is wrong in it is refused."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.tag import Value
from gateway.machine.model.predict import Predictor
from sim.artefacts.effect_lines import effect_lines_text, read_effect_lines
from sim.artefacts.model_json import model_hash, model_text, parse_model
from sim.effects.correction import in_sensor_scale
from sim.effects.kinds import effect_summary
from sim.files import ArtefactError
from sim.lab.discrepancy.augment import augment_model
from sim.lab.discrepancy.fitting.baseline import build_frame
from sim.lab.discrepancy.fitting.candidates import catalogue, entry_of_line, own_roles
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.named import Named, model_effects
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.judging import untested_effects
from sim.lab.discrepancy.layout import present_roles, required_signals
from sim.lab.discrepancy.naming import step
from sim.lab.discrepancy.rules import RULES
from sim.proof.envelope import Assumptions
from sim.proof.verification import verify
from sim.sha.automaton import Effect
from sim.sha.effect_line import EffectLine
from sim.sha.model import Correction, Model
from tests.discrepancy.plants import model as small_model
from tests.discrepancy.plants import plant as small_plant
from tests.effects.engines import LEARNERS, automaton, check_course, model_of, trace_of, with_effects
from tests.gateway.support import scan_of

FILE = """
[[effect]]
name = "slurry-coupling"
meaning = "what is pumped draws the bearing towards its own temperature"
heat = "gain * (feed - temperature) * max(pump, 0)"
acts = "anywhere"
experiment = "pump at two temperatures at one load"
look = "the slurry: its temperature and how much of it flows"
[effect.signals]
feed = "Ta"
pump = "P"
[effect.parameters]
gain = { unit = "1/s", low = 0 }

[[effect]]
name = "wet-load"
meaning = "torque heats more in humid air"
heat = "gain * (load - usual) * sqrt(max(wet, 1)) / (1 + abs(load) / knee)"
experiment = "wet and dry air at one load"
[effect.signals]
load = "I"
wet = "M"
[effect.parameters]
gain = { unit = "degC/s", low = 0 }
usual = { unit = "A", low = 0, high = 350, usual = "load" }
knee = { unit = "A", low = 50, high = 5000, try = [100, 1000] }

[[effect]]
name = "fresh-grease"
meaning = "grease that is pushed aside in the first minutes"
heat = "gain * max(1 - since / span, 0)"
experiment = "start twice within an hour"
[effect.parameters]
gain = { unit = "degC/s", low = 0 }
span = { unit = "s", low = 60, high = 3000 }
"""
PARAMS: dict[str, dict[str, float]] = {
    "slurry-coupling": {"gain": 6e-4},
    "wet-load": {"gain": 3e-5, "usual": 110.0, "knee": 400.0},
    "fresh-grease": {"gain": 0.02, "span": 400.0},
}


@pytest.fixture(scope="module")
def lines(tmp_path_factory: pytest.TempPathFactory) -> dict[str, EffectLine]:
    path = tmp_path_factory.mktemp("own") / "effects.toml"
    path.write_text(FILE, encoding="utf-8")
    return {line.name: line for line in read_effect_lines(path)}


def own(line: EffectLine) -> Named:
    return Named(entry_of_line(line), dict(line.signals), PARAMS[line.name])


def with_own(line: EffectLine) -> Model:
    return with_effects(model_of("bins"), own(line))


@pytest.mark.parametrize("learner", LEARNERS)
@pytest.mark.parametrize("name", PARAMS)
def test_all_engines_have_one_course(lines: dict[str, EffectLine], name: str, learner: str) -> None:
    check_course(own(lines[name]), learner, 0.0)


def test_a_signal_that_was_not_read_adds_nothing(lines: dict[str, EffectLine]) -> None:
    check_course(own(lines["wet-load"]), "bins", 250.0)


def of_the_catalogue() -> Model:
    """The plant with the kind of the catalogue that the first line writes down."""
    kept = Effect("feed-temperature-coupling", {"loss": 6e-4}, {"feed": "Ta", "pump": "P"})
    plain = model_of("bins")
    return replace(plain, sha=replace(plain.sha, effects=(kept,), low=-500.0, high=500.0))


def followed(model: Model) -> list[float]:
    """What the running gateway predicts of each scan (degC)."""
    trace = trace_of()
    predictor = Predictor(model, "T")
    means = []
    for row in range(0, 1200, 20):
        values: dict[str, Value | None] = {
            name: float(column[row - row % 200]) for name, column in trace.signals.items()
        }
        values |= {"on": row > 400, "T": 22.0 + 0.02 * row}
        means.append(predictor.step(scan_of(values, 1.7e9 + float(trace.times[row]))).mean)
    return [mean for mean in means if mean is not None]


def test_it_is_written_and_read_and_followed_by_the_gateway_with_identical_numbers(
    lines: dict[str, EffectLine],
) -> None:
    model = with_own(lines["slurry-coupling"])
    again = parse_model(model_text(model))
    assert again == model and model_hash(again) == model_hash(model)
    assert '"version": 3' in model_text(model)
    trace = trace_of()
    np.testing.assert_array_equal(automaton(again, trace), automaton(model, trace))
    # The same physics as a kind of the catalogue: not near it, but the same numbers.
    np.testing.assert_array_equal(automaton(again, trace), automaton(of_the_catalogue(), trace))
    online = followed(again)
    assert len(online) == 59 and online != followed(model_of("bins"))
    assert online == followed(model) == followed(of_the_catalogue())


def test_the_proof_holds_what_any_signals_do(lines: dict[str, EffectLine]) -> None:
    inputs = {"Ta": (5.0, 40.0), "P": (-1.0, 2.0), "I": (50.0, 200.0), "M": (0.0, 60.0)}
    rng = np.random.default_rng(5)
    for name in PARAMS:
        model = with_own(lines[name])
        model = replace(model, sha=replace(model.sha, low=0.0, high=150.0))
        found = verify(
            model,
            assumptions=Assumptions(inputs={key: inputs[key] for _, key in lines[name].signals}, start=(20.0, 25.0)),
        )
        assert found.bounds is not None, found.reasons
        low = min(least for least, _ in found.bounds.intervals.values())
        high = max(most for _, most in found.bounds.intervals.values())
        for _ in range(4):
            trace = trace_of()
            drawn = {
                key: np.where(np.isfinite(trace.signals[key]), rng.choice(ends, trace.times.size), np.nan)
                for key, ends in inputs.items()
            }
            course = automaton(model, replace(trace, signals={**trace.signals, **drawn}))
            assert low <= course.min() and course.max() <= high
        # Not far beyond either: the hottest target alone is 60 degC.
        assert high < {"slurry-coupling": 61.0, "wet-load": 140.0, "fresh-grease": 80.0}[name]


def test_the_correction_carries_it_along(lines: dict[str, EffectLine]) -> None:
    for name in PARAMS:
        model, change = with_own(lines[name]), Correction(1.8, 32.0)
        scaled = in_sensor_scale(replace(model, correction=change))
        trace = trace_of()
        first = {**trace.signals, "T": 1.8 * trace.signals["T"] + 32.0}
        there = automaton(
            replace(scaled, sha=replace(scaled.sha, low=-900.0, high=900.0)), replace(trace, signals=first)
        )
        np.testing.assert_allclose(there, 1.8 * automaton(model, trace) + 32.0, atol=1e-8)


def test_what_is_written_as_toml_is_read_back(lines: dict[str, EffectLine], tmp_path: Path) -> None:
    path = tmp_path / "again.toml"
    path.write_text(effect_lines_text(tuple(lines.values())), encoding="utf-8")
    assert read_effect_lines(path) == tuple(lines.values())


WATER = """
[[effect]]
name = "cold-water"
meaning = "water that cools the housing while the valve is open"
heat = "gain * max(valve, 0) * (cold - temperature)"
acts = "anywhere"
experiment = "close the valve for an hour at one load"
look = "the valve and the water's temperature"
signals = { valve = "Ventil" }
parameters = { gain = { unit = "1/s", low = 0 }, cold = { unit = "degC", low = 0, high = 30 } }
"""


def test_a_diagnosis_finds_it_and_adds_it_to_the_model(tmp_path: Path) -> None:
    path = tmp_path / "effects.toml"
    path.write_text(WATER, encoding="utf-8")
    lines = read_effect_lines(path)
    # The pump under a name that no role of the catalogue has: without the line nothing could be named.
    trace = small_plant(3, days=2, pump=2e-4)
    trace = replace(trace, signals={**trace.signals, "Ventil": trace.signals["MarciaPmpFango"]})
    present = present_roles([trace], own_roles(lines))
    assert present == {"cold-water.valve": "Ventil"}
    base = fit(build_frame(build_record(small_model(), [trace], required_signals(small_model(), present))), rounds=2)
    entries = catalogue(lines)
    offered = [entry for entry in entries if entry.name in ("cold-water", "startup-churning", "pump-cooling")]
    found = step(base, offered, present, rules=RULES).best
    assert found is not None and found.fitted is not None
    assert (found.entry.name, found.gain > 40.0) == ("cold-water", True)
    named = found.fitted.state.named[-1]
    assert named.strength == pytest.approx(2e-4, rel=0.3) and 5.0 < named.params["cold"] < 28.0
    made = augment_model(found.fitted, name="with water", readings=[trace])
    again = parse_model(model_text(made))
    assert again == made and [effect.kind for effect in again.sha.effects] == ["cold-water"]
    assert effect_summary(again.sha.effects[0]).endswith("heat gain * max(valve, 0) * (cold - temperature)")
    assert [each.entry.line for each in model_effects(again)] == list(lines), "it can be diagnosed again"
    assert "cold-water" in untested_effects(entries, {}, own_roles(lines))
    proven = verify(again, assumptions=Assumptions(inputs={"Ventil": (0.0, 1.0)}))
    assert proven.deployable, proven.reasons


PUMPED = 'heat = "gain * (feed - temperature) * max(pump, 0)"'
USUAL = 'low = 0, high = 350, usual = "load"'
BROKEN: list[tuple[str, str, str]] = [
    (PUMPED, 'heat = "gain * (fed - temperature) * pump"', "heat: 'fed' is neither a signal nor a parameter"),
    (PUMPED, 'heat = "gain * (feed - temperature) * pump"', "heat: it may grow with the temperature"),
    (PUMPED, 'heat = "gain * feed * pump * __import__(feed)"', "heat: column 22: there is no function '__import__'"),
    (PUMPED, 'heat = "gain * feed"', "signals.pump: the heat does not read it"),
    (PUMPED, 'heat = "gain ^ 2 * feed * pump"', "heat: it is not proportional to 'gain'"),
    (PUMPED, 'heat = "gain * feed / pump"', "heat: the divisor may be 0 in gain * feed / pump"),
    (PUMPED, 'heat = "gain * (feed - temperature ^ 2) * max(pump, 0)"', "heat: it bends with the temperature"),
    (
        'heat = "gain * max(1 - since / span, 0)"',
        'heat = "gain * since / span"',
        "heat: it has no bound as `since` grows",
    ),
    ('name = "slurry-coupling"', 'name = "pump-cooling"', "name: 'pump-cooling' is a kind of the catalogue already"),
    (
        'name = "slurry-coupling"',
        'name = "late-current-heating"',
        "name: 'late-current-heating' is a kind of the catalogue already",
    ),
    ('name = "wet-load"', 'name = "slurry-coupling"', "effect[1].name: 'slurry-coupling' stands there twice"),
    ('name = "slurry-coupling"', 'name = "a name"', "effect[0].name: 'a name' is no name"),
    ('acts = "anywhere"', 'acts = "nowhere"', "effect[0].acts: 'nowhere' is unknown"),
    ('acts = "anywhere"', 'act = "anywhere"', "effect[0]: the key 'act' is unknown"),
    ('gain = { unit = "1/s", low = 0 }', 'gain = { unit = "1/s" }', "effect[0].heat: it may grow with the temperature"),
    (
        'gain = { unit = "1/s", low = 0 }',
        'gain = { unit = "1/s", low = "0" }',
        "effect[0].parameters.gain.low: a number is needed",
    ),
    ("low = 50, high = 5000", "low = 0, high = 5000", "effect[1].heat: the divisor may be 0 in abs(load) / knee"),
    ("try = [100, 1000]", "try = [10]", "effect[1].parameters.knee: try has 10, which lies outside"),
    (USUAL, 'low = 0, high = 350, usual = "lode"', "effect[1].parameters.usual: usual names 'lode'"),
    (USUAL, "low = 0", "effect[1].parameters.usual: nothing says where to look for it"),
    (USUAL, "low = 9, high = 3", "effect[1].parameters.usual: low 9 must lie below high 3"),
    ('feed = "Ta"', 'since = "Ta"', "effect[0].signals.since: 'since' has a meaning of its own in a line"),
    ('meaning = "torque heats more in humid air"', "", "effect[1]: the key 'meaning' is missing"),
    ('experiment = "wet and dry air at one load"', 'experiment = " "', "effect[1].experiment: it is empty"),
    ("[[effect]]", "[effect]", "is no TOML"),
]


@pytest.mark.parametrize(("good", "bad", "sentence"), BROKEN, ids=[row[2][:40] for row in BROKEN])
def test_a_wrong_line_is_refused_with_file_key_and_reason(good: str, bad: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "effects.toml"
    path.write_text(FILE.replace(good, bad, 1), encoding="utf-8")
    with pytest.raises(ArtefactError) as error:
        read_effect_lines(path)
    assert str(error.value).startswith(f"{path}: ") and sentence in str(error.value), error.value
    assert "\n" not in str(error.value)


def test_a_line_inside_a_model_is_checked_as_well(lines: dict[str, EffectLine]) -> None:
    text = model_text(with_own(lines["slurry-coupling"]))
    for good, bad, sentence in (
        ("max(pump, 0)", "pump", "effects[0].line.heat: it may grow with the temperature"),
        ('"version": 3', '"version": 2', "version: a model with an own effect has version 3, here it is 2"),
        (
            '"kind": "slurry-coupling"',
            '"kind": "mud"',
            "the effect 'mud' brings a line with the name 'slurry-coupling'",
        ),
    ):
        with pytest.raises(ArtefactError) as error:
            parse_model(text.replace(good, bad, 1))
        assert sentence in str(error.value), error.value


def test_the_page_is_literally_true(tmp_path: Path) -> None:
    page = (Path(__file__).parents[2] / "docs" / "effects.md").read_text(encoding="utf-8")
    (entry,) = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    path = tmp_path / "effects.toml"
    path.write_text(entry, encoding="utf-8")
    (line,) = read_effect_lines(path)
    assert line.name == "slurry-coupling"
    path.write_text(entry.replace("(feed -", "(fed -"), encoding="utf-8")
    with pytest.raises(ArtefactError) as error:
        read_effect_lines(path)
    assert str(error.value).replace(f"{tmp_path}/", "") in page
