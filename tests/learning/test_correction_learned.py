"""Learning T' = k T + b: found again where the sensor was off, not found where it was not, told with honest errors."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sim.artefacts.model_json import model_hash
from sim.artefacts.store import read_model
from sim.engine.open_loop_run import errors, open_loop
from sim.lab.formats.write_model import write_model_directory
from sim.lab.learning import max_rate
from sim.lab.learning.bins.candidates import BinsCandidate
from sim.lab.learning.bins.learn import learn_bins
from sim.lab.learning.correction import corrected_model, learn_correction
from sim.lab.learning.max_rate import bite, learn_max_rate, with_max_rate
from sim.lab.learning.structure import LearningError
from sim.plant.scenarios import scenario
from sim.sha.events import DECANTER
from sim.sha.model import Correction, Model
from sim.sha.trace import Trace
from tests.cli.support import decanter, only_object
from tests.learning.plants import Truth, simulate, with_signal
from tests.rig.no_bands import without_bands

QUIET = Truth(scatter=0.3)
NAMES = ("cd4", "cd6", "cd12")


def off(traces: list[Trace], gain: float, offset: float) -> list[Trace]:
    return [replace(trace, signals={**trace.signals, "T": gain * trace.signals["T"] + offset}) for trace in traces]


def reading(*, seed: int = 5, cycles: int = 10) -> list[Trace]:
    return simulate(QUIET, seed, cycles=cycles, rows=160)


def learned(traces: list[Trace], temperature: str) -> Model:
    """Of one rate, and without the bands, for which it would be fitted three times more: a correction needs none."""
    with pytest.MonkeyPatch.context() as patch:
        without_bands(patch)
        return learn_bins(traces, DECANTER, temperature, seed=0, candidates=[BinsCandidate("constant")]).model


@pytest.fixture(scope="module")
def model() -> Model:
    return learned(simulate(QUIET, 1, cycles=8, rows=160), "T")


@pytest.mark.parametrize(("gain", "offset"), [(1.1, 0.0), (0.9, 4.0), (1.0, -3.0)])
def test_a_sensor_that_is_off_is_found_within_its_standard_errors(model: Model, gain: float, offset: float) -> None:
    found = learn_correction(model, off(reading(), gain, offset), forms=("affine",)).best
    assert found.accepted and found.improvement > 3 * found.improvement_error
    assert found.correction.gain == pytest.approx(gain, abs=max(3.5 * found.gain_error, 0.005))
    assert found.correction.offset == pytest.approx(offset, abs=max(3.5 * found.offset_error, 0.2))
    assert 0 < found.gain_error < 0.1
    assert found.after < 0.5 * found.before


def test_a_pure_gain_is_taken_for_one_and_an_offset_is_not(model: Model) -> None:
    assert learn_correction(model, off(reading(), 1.15, 0.0)).chosen == "gain"
    assert learn_correction(model, off(reading(), 1.0, 6.0)).chosen == "affine"


def test_a_sensor_that_is_right_gets_no_correction_worth_speaking_of(model: Model) -> None:
    found = learn_correction(model, reading(seed=11))
    for fit in found.fits:
        assert abs(fit.correction.gain - 1.0) < 4 * fit.gain_error + 0.01
    assert abs(found.best.improvement) < 0.1


def test_corrected_the_open_loop_is_that_much_better_on_traces_not_seen(model: Model) -> None:
    traces = off(reading(), 1.1, 2.0)
    learned = learn_correction(model, traces)
    better = corrected_model(model, learned, traces, model_hash(model))
    unseen = off(reading(seed=77, cycles=4), 1.1, 2.0)

    def mae(one: Model) -> float:
        return float(np.mean([errors(open_loop(one, t, "resync"), t, "T").at_samples.mae for t in unseen]))

    assert mae(better) < 0.5 * mae(model)
    assert mae(better) == pytest.approx(learned.best.after, rel=0.6)
    assert better.provenance.parent == model_hash(model)
    assert better.provenance.settings["correction_form"] == learned.chosen
    assert better.provenance.data_hash == model.provenance.data_hash


def test_the_standard_error_is_that_of_repeated_experiments(model: Model) -> None:
    gains, told = [], []
    for seed in range(20, 32):
        fit = learn_correction(model, off(reading(seed=seed, cycles=8), 1.1, 0.0), forms=("gain",)).best
        gains.append(fit.correction.gain)
        told.append(fit.gain_error)
    spread, said = float(np.std(gains, ddof=1)), float(np.mean(told))
    assert 0.4 < said / spread < 2.5, "within what 12 experiments can tell"


def test_a_new_correction_takes_the_place_of_the_old_one(model: Model) -> None:
    traces = off(reading(), 1.1, 0.0)
    once = learn_correction(model, traces, forms=("gain",))
    again = learn_correction(replace(model, correction=once.correction), traces, forms=("gain",))
    assert again.best.correction == once.best.correction
    assert again.chosen is None and again.correction == once.correction, "there is nothing left to gain"


def test_few_long_traces_are_cut_into_runs_and_spikes_do_not_count(model: Model) -> None:
    (trace,) = off(simulate(QUIET, 9, cycles=1, rows=900), 1.1, 0.0)
    column = trace.signals["T"].copy()
    column[50::97] = 400.0
    found = learn_correction(model, [with_signal(trace, T=column)], forms=("gain",)).best
    assert found.runs == 8
    assert found.correction.gain == pytest.approx(1.1, abs=0.03)


def test_what_cannot_be_judged_or_is_no_calibration_is_refused(model: Model) -> None:
    short = replace(reading()[0], signals={**reading()[0].signals, "T": np.full(160, np.nan)})
    with pytest.raises(LearningError, match="at least 2"):
        learn_correction(model, [short])
    wild = learn_correction(model, off(reading(), 3.0, 0.0), forms=("gain",))
    assert wild.chosen is None and "learn a new model" in wild.best.reason
    assert wild.correction == Correction()


def test_the_greatest_rate_is_found_a_single_jump_is_none_and_noise_is_none() -> None:
    rng = np.random.default_rng(1)
    times = np.arange(0.0, 3000.0, 2.0)
    ramp = 30.0 + np.interp(times % 1000.0, [0.0, 200.0, 1000.0], [0.0, 10.0, 0.0])
    trace = Trace("ramps", times, {"T": ramp + 0.1 * rng.standard_normal(times.size)})
    found = learn_max_rate([trace], "T")
    assert found.observed == pytest.approx(10.0 / 200.0, rel=0.1)
    assert found.rate == pytest.approx(1.5 * found.observed)
    jump = replace(trace, signals={"T": trace.signals["T"] + 40.0 * (times > 1510.0)})
    assert learn_max_rate([jump], "T").observed == pytest.approx(found.observed, rel=0.1)
    with pytest.raises(LearningError, match="never moves"):
        learn_max_rate([replace(trace, signals={"T": np.full(times.size, 30.0)})], "T")
    with pytest.raises(LearningError, match="too few"):
        learn_max_rate([trace.between(0.0, 100.0)], "T")


def test_a_limit_bites_a_model_that_is_too_fast_and_is_not_accepted_where_it_does_harm(model: Model) -> None:
    traces = reading()
    rate = learn_max_rate(traces, "T")
    limited = with_max_rate(replace(model, correction=Correction(2.0, 0.0)), rate)
    assert limited.sha.max_rate == pytest.approx(rate.rate / 2.0), "the automaton's own rate"
    assert bite(with_max_rate(model, replace(rate, rate=2 * rate.rate)), traces).accepted
    slow = bite(with_max_rate(model, replace(rate, rate=rate.rate / 50.0)), traces)
    assert slow.limited > 100 and not slow.accepted and slow.after > slow.before


@pytest.mark.parametrize(("growth", "accepted"), [(0.9, True), (1.1, False)])
def test_a_growth_of_the_error_within_its_standard_error_is_accepted(
    model: Model, monkeypatch: pytest.MonkeyPatch, growth: float, accepted: bool
) -> None:
    """Four traces whose errors grow by so many of their standard errors in the mean, told by hand."""
    told = iter([5.0] * 4 + [5.0 + growth + np.sqrt(3.0) * sign for sign in (-1, -1, 1, 1)])
    monkeypatch.setattr(max_rate, "open_loop", lambda *_: SimpleNamespace(limited=3))
    monkeypatch.setattr(max_rate, "errors", lambda *_: SimpleNamespace(at_samples=SimpleNamespace(mae=next(told))))
    found = bite(model, reading(cycles=4)[:1] * 4)
    assert found.limited == 12 and (found.before, found.after) == pytest.approx((5.0, 5.0 + growth))
    assert found.accepted is accepted


def test_the_command_learns_reports_and_writes_the_corrected_model(tmp_path: Path) -> None:
    assert decanter("trace", "synth", *NAMES, "--out", tmp_path / "traces", "--seed", 3).exit_code == 0
    same = [scenario(name) for name in NAMES]
    first = learned(same, "TCuscinettiRiduttore")
    wrong = replace(first, correction=Correction(0.8, 0.0))
    write_model_directory(tmp_path / "wrong", wrong)
    done = decanter(
        "model",
        "learn",
        "correction",
        tmp_path / "wrong",
        "--traces",
        tmp_path / "traces",
        "--out",
        tmp_path / "out",
        "--form",
        "gain",
        "--max-rate",
        "--json",
    )
    said = only_object(done.stdout)
    assert said["chosen"] == "gain" and said["correction"]["gain"] == pytest.approx(1.0, abs=0.1)
    assert said["fits"][0]["before"] > said["fits"][0]["after"] and said["max_rate"]["rate"] > 0
    corrected = read_model(tmp_path / "out")
    assert corrected.correction.gain == said["correction"]["gain"]
    assert corrected.provenance.parent == model_hash(wrong)
    shown = decanter("model", "show", tmp_path / "out").stdout
    assert "correction T' = " in shown
    nothing = decanter(
        "model",
        "learn",
        "correction",
        tmp_path / "out",
        "--traces",
        tmp_path / "traces",
        "--form",
        "gain",
        "--out",
        tmp_path / "no",
    )
    assert nothing.exit_code == 1 and "nothing was accepted" in nothing.stderr
    assert not (tmp_path / "no").exists()
