"""One model along one trace: known answers, every stage's failure in its sentence, the same numbers anywhere."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.judge import free_run as trace_run
from sim.lab.judge.free_run import TraceJob, TraceOutcome, TraceRunSettings, run_job
from sim.sha.events import Alphabet, Switch
from sim.sha.model import Correction, Model
from sim.sha.trace import Trace
from tests.validation.small_plant import location, plant_model, plant_trace, without_edge

SETTINGS = TraceRunSettings(runs=400)


def run(model: Model, trace: Trace, settings: TraceRunSettings = SETTINGS, refusal: str = "") -> TraceOutcome:
    return run_job(
        TraceJob(label="plant", semantics="carried", model=model, trace=trace, settings=settings, refusal=refusal)
    )


def test_a_trace_that_follows_the_model_exactly_has_no_error_at_all() -> None:
    result = run(plant_model(sensor=0.0), plant_trace()).result
    assert (result.failure, result.stage, result.accepted, result.readings, result.events) == ("", 9, True, 300, 5)
    assert result.duration == 299.0
    for figure in (result.mae.value, result.rmse.value, result.at_events.mae, result.dense.rmse, result.max_error):
        assert figure == pytest.approx(0.0, abs=1e-9)
    assert result.final_error == pytest.approx(0.0, abs=1e-9) and result.error_quantiles == pytest.approx([0.0] * 7)
    assert result.persistence > 5.0


def test_the_sensors_noise_alone_is_covered_by_the_band_and_is_the_error() -> None:
    result = run(plant_model(sensor=0.5), plant_trace(rows=2000, noise=0.5, seed=3), TraceRunSettings(runs=1000)).result
    assert result.rmse.value == pytest.approx(0.5, rel=0.1)
    assert result.rmse.low < 0.5 < result.rmse.high
    assert result.coverage == pytest.approx(0.9, abs=0.03) and result.beyond < 0.01
    assert result.crps == pytest.approx(0.5 / np.sqrt(np.pi), rel=0.1)


def test_an_offset_of_the_target_is_the_error_that_the_closed_form_says() -> None:
    model = plant_model(sensor=0.0)
    high = replace(model, sha=replace(model.sha, locations=(location("off", 20.0), location("on", 70.0))))
    result = run(high, plant_trace(rows=61)).result
    expected = 10.0 * (1.0 - np.exp(-0.01 * np.arange(61)))
    assert result.mae.value == pytest.approx(expected.mean())
    assert result.final_error == pytest.approx(expected[-1]) and result.max_error == pytest.approx(expected[-1])
    assert result.final_percent == pytest.approx(100 * expected[-1] / plant_trace(rows=61).signals["T"][-1])


def test_a_model_with_a_correction_is_compared_in_the_sensors_scale() -> None:
    model, trace = plant_model(sensor=0.0), plant_trace()
    shifted = Trace(trace.name, trace.times, {**trace.signals, "T": trace.signals["T"] + 4.0})
    assert run(replace(model, correction=Correction(1.0, 4.0)), shifted).result.mae.value == pytest.approx(0, abs=1e-9)


def test_a_long_trace_is_simulated_at_a_part_of_its_readings_and_measured_at_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model, trace = plant_model(sensor=0.3, sigma=1.0, noise=0.05), plant_trace(rows=3000, noise=0.3)
    whole = run(model, trace)
    monkeypatch.setattr(trace_run, "MAX_RUN_BYTES", 8 * 400 * 500)
    part = run(model, trace)
    assert (whole.simulated, part.simulated) == (3000, 500)
    assert part.result.at_samples == whole.result.at_samples
    assert part.result.coverage == pytest.approx(whole.result.coverage, abs=0.03)
    assert part.result.crps == pytest.approx(whole.result.crps, rel=0.05)


def test_the_dense_comparison_takes_the_first_rows_of_a_long_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trace_run, "MAX_DENSE_ROWS", 100)
    outcome = run(plant_model(), plant_trace())
    assert outcome.comparison.rows == 100 and outcome.result.dense.count == 100
    assert outcome.result.at_samples.count == 300


def test_a_gap_a_clock_that_repeats_and_missing_readings_are_no_trouble() -> None:
    trace = plant_trace()
    times = np.where(trace.times > 1200, trace.times + 500.0, trace.times)
    times[10] = times[9]
    temperature = trace.signals["T"].copy()
    temperature[::3] = np.nan
    result = run(plant_model(), replace(trace, times=times, signals={**trace.signals, "T": temperature})).result
    assert result.failure == "" and result.readings == 200 and np.isfinite(result.crps)


def test_the_same_job_gives_the_same_result_and_another_trace_or_seed_other_runs() -> None:
    model, trace = plant_model(sigma=2.0), plant_trace(noise=0.1)

    def figures(outcome: TraceOutcome) -> tuple[float, float]:
        return outcome.result.crps, outcome.result.mae.low

    first = figures(run(model, trace))
    assert figures(run(model, trace)) == first
    assert figures(run(model, replace(trace, name="other"))) != first
    assert figures(run(model, trace, TraceRunSettings(runs=400, seed=1))) != first


@pytest.mark.parametrize(
    ("trace", "stage", "words"),
    [
        (Trace("cold", plant_trace().times, {"Motor": plant_trace().signals["Motor"]}), 5, "no signal 'T'"),
        (replace(plant_trace(), signals={"T": np.full(300, np.nan)}), 5, "no reading"),
        (plant_trace(rows=1), 5, "one reading"),
        (Trace("empty", np.empty(0), {"T": np.empty(0)}), 5, "no reading"),
        (replace(plant_trace(), signals={"T": np.full(300, np.inf)}), 5, "no reading"),
    ],
    ids=["no temperature", "all NaN", "one row", "no row", "infinite"],
)
def test_an_unusable_trace_fails_at_its_stage_with_a_sentence(trace: Trace, stage: int, words: str) -> None:
    result = run(plant_model(), trace).result
    assert result.stage == stage and words in result.failure and np.isnan(result.mae.value)


def test_the_policy_decides_about_an_event_without_an_edge_and_the_result_names_it() -> None:
    model = without_edge(plant_model(), "on", "M_OFF")
    rejected = run(model, plant_trace(), replace(SETTINGS, policy="reject")).result
    assert rejected.stage == 6 and "'M_OFF'" in rejected.failure and "'on'" in rejected.failure
    for settings in (TraceRunSettings(400, "ignore"), TraceRunSettings(400, "resync")):
        result = run(model, plant_trace(), settings).result
        assert result.failure == "" and not result.accepted and "'M_OFF'" in result.rejected
        assert any("no edge" in flag for flag in result.flags)


def test_a_model_that_knows_none_of_the_events_is_not_simulated() -> None:
    model = replace(plant_model(), alphabet=Alphabet((Switch("Motor", "GO", "STOP"),)))
    result = run(model, plant_trace()).result
    assert result.stage == 6 and "knows none" in result.failure and "M_ON" in result.failure


def test_a_refused_model_has_its_events_checked_and_nothing_simulated() -> None:
    outcome = run(plant_model(), plant_trace(), refusal="its flow is quadratic")
    result = outcome.result
    assert (result.stage, result.failure, result.accepted, result.events) == (4, "its flow is quadratic", True, 5)
    assert outcome.course is None and outcome.simulated == 0


def test_a_trace_without_the_signal_of_a_channel_runs_and_says_that_its_events_cannot_be_seen() -> None:
    trace = plant_trace()
    result = run(plant_model(), replace(trace, signals={"T": trace.signals["T"]})).result
    assert result.failure == "" and result.events == 0 and any("no Motor" in flag for flag in result.flags)


def test_runs_that_leave_the_models_range_are_flagged() -> None:
    model = plant_model(sensor=0.0, sigma=5.0)
    narrow = replace(model, sha=replace(model.sha, high=45.0))
    result = run(narrow, plant_trace()).result
    assert any(flag.startswith("runs: ") for flag in result.flags)
