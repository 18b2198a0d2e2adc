"""The gateway's forecasts along a recorded trace, as it would have made them: for whoever wants to score them.

Predictor, bands and ensemble are the running gateway's own; only clock and device are the trace's. Nothing is known of
the events to come, and nothing that lies after the scan at hand is looked at.
"""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from math import inf

import numpy as np
from numpy.typing import NDArray

from drivers.tag import Quality, Sample
from gateway.machine.model.ensemble import Ensemble
from gateway.machine.model.outlook import Outlook
from gateway.machine.model.predict import Predictor, ScanPrediction
from gateway.machine.reading import Scan
from gateway.settings import EnsembleSection, ForecastSection
from sim.artefacts import model_hash
from sim.forecast import DENSE_LEVELS, Forecast
from sim.sha import Alphabet, Array, Mask, Model, Trace


def new_readings(
    trace: Trace, alphabet: Alphabet, rows: NDArray[np.intp], moments: Array
) -> dict[str, tuple[NDArray[np.intp], Mask]]:
    """Of each signal, at `rows` (m,) of a trace that are shown at `moments` (m,) s: (m,) the row of its newest reading,
    good or bad, and (m,) whether that one still holds then.

    Nothing is held over a step between rows longer than the alphabet's gap, nor for longer than that, unless the
    signal's channel is only sent on change. Where there was no reading yet, nothing holds, and the row is -1.
    """
    places = np.arange(trace.times.size)
    step = np.diff(trace.times, prepend=trace.times[:1])
    begins = np.maximum.accumulate(np.where(step > alphabet.gap, places, 0))[rows]
    lasting = {channel.signal for channel in alphabet.channels if channel.on_change}
    found = {}
    for name, values in trace.signals.items():
        bad = trace.bad.get(name, np.zeros(values.shape, dtype=bool))
        news = np.maximum.accumulate(np.where(np.isfinite(values) | bad, places, -1))[rows]
        recent = (moments - trace.times[news] <= alphabet.gap) | (name in lasting)
        found[name] = news, (news >= begins) & recent
    return found


def recorded_scans(trace: Trace, period: float, alphabet: Alphabet) -> Iterator[Scan]:
    """Scans every `period` seconds, as of a device that shows the trace: each signal's newest reading, held.

    A tick without a new row brings no scan. What is held is by the law of `new_readings`.
    """
    if not trace.times.size:
        return
    times = trace.times
    # The tick that shows a row is the first one at or after it; the tolerance is for clocks in decimal fractions.
    ticks = np.ceil((times - times[0]) / period - 1e-6)
    rows = np.flatnonzero(np.diff(ticks, append=inf) > 0)
    moments = times[0] + period * ticks[rows]
    columns = []
    for name, (news, held) in new_readings(trace, alphabet, rows, moments).items():
        values = trace.signals[name][news]
        good = held & np.isfinite(values)
        columns.append((name, times[news].tolist(), values.tolist(), good.tolist(), held.tolist()))
    for number, moment in enumerate(moments.tolist()):
        samples = {}
        for name, read_at, values, good, held in columns:
            if good[number]:
                samples[name] = Sample(name, values[number], Quality.GOOD, read_at[number])
            else:
                samples[name] = Sample(name, None, Quality.BAD if held[number] else Quality.NO_DATA, read_at[number])
        # Early in the sense of a scan: what it shows again of the scan before it must not correct the model twice.
        yield Scan(number, moment, samples, 0, 0.0, early=True)


def forecast_trace(
    models: Sequence[Model],
    trace: Trace,
    forecasts: ForecastSection,
    *,
    ensemble: EnsembleSection | None = None,
    scan_period: float = 1.0,
    levels: tuple[float, ...] = DENSE_LEVELS,
    limit: float = inf,
    since: float = -inf,
    progress: Callable[[float], None] | None = None,
    seen: Callable[[ScanPrediction], None] | None = None,
) -> list[Forecast]:
    """Every forecast that the gateway would have made along `trace` with the first of `models`, the others its members.

    The fans are at `levels`, which hold LEVELS; `limit` (degC) is the one whose chance they tell, and `seen` is
    given the prediction of each scan. None is made before `since` (s, of the trace's clock). Raises ValueError for a
    trace without a signal that a model reads, and what a model raises.
    """
    first = models[0]
    predictor = Predictor(first, first.temperature)
    lacking = sorted(
        {name for model in models for name in Predictor(model, first.temperature).missing_inputs(trace.signals)}
    )
    if lacking:
        names = ", ".join(sorted(trace.signals))
        raise ValueError(f"trace {trace.name!r}: the model reads {', '.join(lacking)}; the trace has {names}")
    members = None
    section = ensemble or EnsembleSection()
    if len(models) > 1 or (section.plain and first.plain):
        members = Ensemble(
            predictor,
            [model_hash(model) for model in models],
            models[1:],
            section=section,
            forecasts=forecasts,
            scan_period=scan_period,
        )
    outlook = Outlook(predictor, forecasts, limit, scan_period, members, levels=levels)
    made: list[Forecast] = []

    async def follow() -> None:
        for scan in recorded_scans(trace, scan_period, first.alphabet):
            # The order of `ModelUnit`'s stages, without what the forecast has no part in.
            prediction = predictor.step(scan)
            if seen is not None:
                seen(prediction)
            outlook.settle(prediction.time, prediction.measured)
            if prediction.reset:
                outlook.void()
            outlook.follow(scan, prediction.measured)
            known = prediction.known and prediction.inputs_good and scan.time >= since
            outlook.begin(scan.time, known=known, measured=prediction.measured)
            # The trace's clock stands still meanwhile: a forecast is done before the next scan, on any machine.
            await outlook.finish()
            if (finished := outlook.collect()) is not None:
                made.append(finished.forecast)
                if progress is not None:
                    progress((scan.time - trace.times[0]) / max(trace.times[-1] - trace.times[0], 1e-9))

    asyncio.run(follow())
    return made


def estimate_offset(model: Model, trace: Trace, *, scan_period: float = 1.0) -> tuple[float, float] | None:
    """What the gateway knows at the end of `trace` of its machine: (mean, standard deviation) in degC of its offset.

    None where the model has no offset of machines, and for a trace without rows.
    """
    predictor = Predictor(model, model.temperature)
    for scan in recorded_scans(trace, scan_period, model.alphabet):
        predictor.step(scan)
    return predictor.machine_offset
