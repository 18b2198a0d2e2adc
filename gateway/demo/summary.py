"""What came out of a demonstration: errors, forecasts against persistence, write-back, outage, judge, picture."""

import json
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from math import inf
from pathlib import Path
from typing import Any

import numpy as np

from drivers.driver import Hears, open_driver
from drivers.tag import Quality
from gateway.demo.child import DemoError
from gateway.demo.folder import FURTHER_PICTURE
from gateway.demo.heat import heat_result, raised_alarms
from gateway.demo.heat_picture import draw_heat
from gateway.demo.prepare import DemoBearing, DemoRun
from gateway.machine.reading import STALE_PERIODS
from gateway.settings import load_device
from gateway.store import events, history, mature_forecasts, samples, scorecard, to_trace
from sim.lab.judge import FitnessLimits, TraceJob, TraceRunSettings, fitness_verdict, model_facts, run_job
from sim.lab.judge import judge as criteria
from sim.lab.pictures import Curve, Picture, draw
from sim.sha import Array, Mask, Model

AHEAD_S = 300.0
"""The horizon (s) that the picture shows."""
FITNESS_RUNS = 200


BEARING_COLUMNS = ("bearing", "blocks", "model", "hottest", "alarms", "in 5 min")
"""Blocks accepted/refused, whether its model may be used, alarms of the forecast, mean error 5 minutes ahead."""


def fitness(setting: DemoRun, model: Model) -> dict[str, str]:
    """Whether the model may be used, as `decanter model judge validation` judges it along the run's trace, and why not.

    A model of a simulated plant is judged by how it serves that plant.
    """
    trace = setting.trace
    run = TraceRunSettings(FITNESS_RUNS, seed=setting.seed)
    job = TraceJob(label=model.sha.name, semantics="carried", model=model, trace=trace, settings=run, seen="no")
    found = criteria([run_job(job).result], model_facts(model), FitnessLimits(synthetic=trace.synthetic))
    verdict = fitness_verdict(found)
    return {"word": verdict.word, "why": verdict.why}


def judge(setting: DemoRun, recording: Path, historian: Path) -> dict[str, Any]:
    """The verdict of the PLC's recording on every reading that the gateway held for good. Raises DemoError.

    A good value may be as old as the gateway's rule allows (three periods), and no older: of a device that speaks by
    itself, since what it said last may still have been what it is, by its device file.
    """
    held = {name: seconds * setting.speed for name, seconds in validity_seconds(setting).items()}
    path = setting.folder / "samples.jsonl"
    with path.open("w", encoding="utf-8") as lines:
        lines.writelines(json.dumps(row) + "\n" for row in good_readings(historian, held))
    return verdict(recording, path, tolerance=(STALE_PERIODS + 1) * setting.period)


def validity_seconds(setting: DemoRun) -> Mapping[str, float]:
    """Real seconds for which the driver of this run holds what was said last, by tag; without the tags that are asked.

    Raises DriverError."""
    device = load_device(setting.addresses or setting.device)
    (link,) = tomllib.loads(setting.plant.read_text(encoding="utf-8"))["device"]["links"]
    settings = {key: value for key, value in link.items() if key not in ("name", "file")}
    driver = open_driver(device.driver, {**device.settings, **settings}, clock=lambda: 0.0)
    return driver.validity_seconds(device.tags) if isinstance(driver, Hears) else {}


def good_readings(historian: Path, held: Mapping[str, float]) -> Iterator[dict[str, Any]]:
    """Every reading that was held for good, one a tag and scan; texts as they were stored, once a change.

    What the historian did not store because it equalled the reading before is there again. What the device says by
    itself is true of some moment in the time that its driver holds it: `held`, plant seconds by tag.
    """
    trace = to_trace(historian)
    for name, column in trace.signals.items():
        good, late = np.isfinite(column), held.get(name, 0.0)
        for time, value in zip(trace.times[good].tolist(), column[good].tolist(), strict=True):
            yield {"tag": name, "value": value, "quality": int(Quality.GOOD), "time": time, "sent": time - late}
    for sample in samples(historian):
        if isinstance(sample.value, str) and sample.quality.is_good:
            yield {"tag": sample.tag, "value": sample.value, "quality": int(Quality.GOOD), "time": sample.time}


def verdict(recording: Path, readings: Path, *, tolerance: float) -> dict[str, Any]:
    """What `sim.plc.record.verdict` says of readings, as a process.

    Raises DemoError when it judged nothing."""
    command = [
        sys.executable,
        "-m",
        "sim.plc.record.verdict",
        str(recording),
        str(readings),
        "--tolerance",
        repr(tolerance),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not done.stdout:
        raise DemoError(f"the recording could not be judged: {done.stderr.strip()}")
    account: dict[str, Any] = json.loads(done.stdout)
    if not account["good"]:
        raise DemoError(f"nothing could be judged: the gateway held no reading for good ({readings} is empty)")
    return account


def outage(happened: Sequence[Mapping[str, Any]], times: Array, good: Mask, speed: float) -> dict[str, float | None]:
    """Real seconds from the fault to the first reading that was not good, and from its end to the first good one.

    `happened` are the PLC's events; theirs and `times` (n,), the scans', are plant seconds on one clock, of which
    `speed` make a real second; `good` (n,) tells of each scan whether the temperature was good. None: it did not come
    to that, and a reading that failed only after the recovery is no detection.
    """
    begun, ended = (
        next((float(row["time"]) for row in happened if row["event"] == event), inf)
        for event in ("fault began", "fault ended")
    )
    lost, back = _first(times[~good], begun), _first(times[good], ended)
    return {
        "detected_s": (lost - begun) / speed if lost < back else None,
        "recovered_s": (back - ended) / speed if back < inf else None,
    }


def _first(times: Array, after: float) -> float:
    later = times[times >= after]
    return float(later[0]) if later.size else inf


def bearing_result(
    setting: DemoRun, bearing: DemoBearing, historian: Path, blocks: Mapping[str, Mapping[str, int]]
) -> dict[str, Any]:
    """What became of one bearing's prediction; errors in degC, `raised` in plant seconds UTC.

    `blocks` are the PLC's account by suffix.
    """
    card = scorecard(historian, temperature=bearing.temperature)
    seen = history(historian, temperature=bearing.temperature)
    # By horizon in seconds. Persistence's CRPS is its `persistence_mae` (a single value's CRPS is its absolute error);
    # `crps` is the model's, from five quantiles, which comes out 3 % too low for a Gaussian and so favours the model by
    # as much.
    forecasts = {
        f"{forecast.horizon:g}": {
            "mae": forecast.mae,
            "persistence_mae": forecast.persistence_mae,
            "crps": forecast.crps,
            "coverage90": forecast.coverage90,
            "count": forecast.count,
        }
        for forecast in card.forecasts
    }
    layout = load_device(setting.device).find_block(bearing.temperature)
    judged = blocks.get(layout.suffix if layout else "", {"accepted": 0, "refused": 0})
    return {
        "temperature": bearing.temperature,
        "limit": bearing.limit,
        "model": bearing.model.sha.name,
        "fitness": fitness(setting, bearing.model),
        "hottest": float(np.nanmax(seen.measured)) if np.isfinite(seen.measured).any() else None,
        "raised": list(raised_alarms(historian, setting, bearing)),
        "events": card.events,
        "samples": card.samples,
        "errors": {
            "free_run": {"rmse": card.free_run.rmse, "mae": card.free_run.mae},
            "one_step": {"rmse": card.one_step.rmse, "mae": card.one_step.mae},
        },
        "forecast": forecasts,
        "guards": dict(card.guards),
        "writeback": {**judged, "latency_ms": {"p50": card.writes.p50, "p99": card.writes.p99}},
    }


def result(setting: DemoRun, recording: Path, historian: Path, picture: Path) -> dict[str, Any]:
    """The demonstration's figures as one object, and its picture in the file `picture`; errors in degC.

    The figures of each bearing stand under `bearings`, those of the first one beside that too; blocks are counted
    there for all.
    """
    account, seen = judge(setting, recording, historian), history(historian)
    bearings = [bearing_result(setting, bearing, historian, account["blocks"]) for bearing in setting.bearings]
    heat = heat_result(setting, setting.trace, historian, account["events"]) if setting.live else None
    if heat is None:
        for bearing in setting.bearings:
            further = picture.with_name(f"{FURTHER_PICTURE}{bearing.temperature}.png")
            draw_result(setting, bearing, historian, picture if bearing is setting.bearings[0] else further)
    else:
        draw_heat(setting, heat, historian, account["events"], picture)
    return {
        **bearings[0],
        "writeback": {
            **bearings[0]["writeback"],
            "accepted": account["blocks_accepted"],
            "refused": account["blocks_refused"],
        },
        "bearings": bearings,
        "heat": heat,
        "synthetic": setting.trace.synthetic,
        "trace": setting.trace.name,
        "link": setting.link,
        "rows": int(setting.trace.times.size),
        "speed": setting.speed,
        "outage": outage(account["events"], seen.times, np.isfinite(seen.measured), setting.speed),
        "wrong_good": account["wrong_good"],
        "judged": account["judged"],
        "notes": list(setting.notes),
        "picture": str(picture),
        "log": str(setting.folder / "gateway.log.jsonl"),
    }


def bearing_row(bearing: Mapping[str, Any]) -> list[str]:
    """One bearing's row under BEARING_COLUMNS."""
    written, ahead, hottest = bearing["writeback"], bearing["forecast"].get(f"{AHEAD_S:g}"), bearing["hottest"]
    known = ahead is not None and ahead["count"]
    return [
        bearing["temperature"],
        f"{written['accepted']}/{written['refused']}",
        bearing["fitness"]["word"],
        "-" if hottest is None else f"{hottest:.1f} °C",
        str(len(bearing["raised"])),
        f"{ahead['mae']:.2f} °C" if known else "-",
    ]


def findings(data: Mapping[str, Any]) -> list[str]:
    """What the figures of the first bearing say, honestly: where persistence wins, it is said."""
    fit = data["fitness"]
    lines = [f"the model is {fit['word']}: {fit['why']}"] if fit["why"] else []
    for horizon, forecast in data["forecast"].items():
        if not forecast["count"]:
            lines.append(f"{float(horizon) / 60:g} min ahead: no forecast matured within the replay")
            continue
        wins = (
            "the model is better"
            if forecast["mae"] < forecast["persistence_mae"]
            else "PERSISTENCE IS AS GOOD OR BETTER"
        )
        lines += [
            f"{float(horizon) / 60:g} min ahead: mean error {forecast['mae']:.3f} °C, persistence "
            f"{forecast['persistence_mae']:.3f} °C: {wins}",
            f"  the 90 % band held {100 * forecast['coverage90']:.0f} % of {forecast['count']} readings",
        ]
    guards = data["guards"]
    if guards.get("review"):
        flagged = ", ".join(name for name, review in guards["reviews"].items() if review["flagged"])
        lines.append(f"REVIEW: readings lie beyond 3 sigma of the model too often ({flagged})")
    left = sum(guards.get("clamps", {}).values())
    if left:
        lines.append(f"the model left its temperature range {left} times and was put back to its border")
    return lines


def draw_result(setting: DemoRun, bearing: DemoBearing, historian: Path, path: Path) -> Path:
    """A bearing's picture of a replay: measured, predicted, free run, forecast made five minutes before, events."""
    temperature = bearing.temperature
    seen = history(historian, temperature=temperature)
    measured, known = np.isfinite(seen.measured), np.isfinite(seen.mean)
    free = np.isfinite(seen.free_run)
    trace = to_trace(historian)
    ahead = mature_forecasts(historian, temperature=temperature).get(AHEAD_S)
    # Stretches without a good reading. Taken for good before the first scan and after the last, so that each beginning
    # has its end: edges come in pairs.
    outages: list[tuple[float, float]] = []
    if seen.times.size:
        edges = np.flatnonzero(np.diff(np.concatenate([[1], measured.astype(int), [1]])))
        outages = [
            (float(seen.times[start]), float(seen.times[min(end, seen.times.size - 1)]))
            for start, end in zip(edges[::2], edges[1::2], strict=True)
        ]
    picture = Picture(
        f"decanter demo: {temperature}, {setting.trace.name}",
        Curve("measured", seen.times[measured], seen.measured[measured]),
        predicted=Curve("predicted, 90 % band", seen.times[known], seen.mean[known], seen.low[known], seen.high[known]),
        open_loop=Curve("free run", seen.times[free], seen.free_run[free]),
        ahead=None
        if ahead is None
        else Curve(
            "forecast issued 5 minutes before, 90 % band",
            ahead.times + AHEAD_S,
            ahead.quantiles[:, ahead.levels.index(0.5)],
            ahead.quantiles[:, ahead.levels.index(0.05)],
            ahead.quantiles[:, ahead.levels.index(0.95)],
        ),
        inputs=[
            Curve(channel.signal, trace.times[present], trace.signals[channel.signal][present])
            for channel in bearing.model.alphabet.channels
            if channel.signal in trace.signals
            and (present := np.isfinite(trace.signals[channel.signal])).any()
            and set(np.unique(trace.signals[channel.signal][present])) - {0.0, 1.0}
        ],
        events=events(historian, temperature=temperature),
        outages=outages,
        limit=bearing.limit,
        units={tag.name: tag.unit for tag in load_device(setting.device).tags},
        note="SYNTHETIC: not measured on a plant" if setting.trace.synthetic else setting.trace.origin,
    )
    return draw(picture, path)
