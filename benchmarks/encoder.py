"""Speed of the encoder, samples (rows) per second: a row at a time as in the gateway, and a whole trace at once.

The rows are a synthetic working day of the decanter, sampled every 10 s, one after another until there are 2.6 million,
the size of a month at one row a second. Streaming has two limits: the same loop over the same rows that does nothing,
and one that takes the readings and compares them with the bounds of their bins, on local variables, and knows neither
time nor bad quality. The batch limit is one pass of numpy over the same arrays: each column compared with its
thresholds, each step of the clock with the gap. Streaming and batch must give the same events, or there is no figure.
Best of the repetitions.
"""

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf

import click
import numpy as np

from benchmarks.figures import Figure, best, give
from sim.plant.scenarios import production
from sim.sha.events import DECANTER, Encoder, encode
from sim.sha.trace import Event, Trace

ROWS, STREAMED = 2_600_000, 200_000
SWITCH, CURRENT = "MarciaDecanter", "Assorbimento"

Rows = Sequence[tuple[float, Mapping[str, float | None]]]


def long_trace(rows: int, seed: int) -> Trace:
    """`rows` rows of the two signals of the alphabet: a day, again and again."""
    day = production(1, seed=seed)
    copies = -(-rows // day.times.size)
    step = day.times[-1] - day.times[0] + 10.0
    times = np.concatenate([day.times + number * step for number in range(copies)])[:rows]
    signals = {name: np.tile(day.signals[name], copies)[:rows] for name in (SWITCH, CURRENT)}
    return Trace("month", times, signals, synthetic=True)


def as_rows(trace: Trace) -> Rows:
    """What the gateway would give to the encoder."""
    columns = zip(trace.times.tolist(), *(trace.signals[name].tolist() for name in (SWITCH, CURRENT)), strict=True)
    return [(time, {SWITCH: on, CURRENT: current}) for time, on, current in columns]


def stream(rows: Rows) -> list[Event]:
    encoder, events = Encoder(DECANTER), []
    for time, readings in rows:
        events += encoder.feed(time, readings)
    return events


def bare_loop(rows: Rows) -> None:
    for _time, _readings in rows:
        pass


def bare_decisions(rows: Rows) -> int:
    """The other streaming limit: see the module."""
    thresholds = (-inf, 100.0, 200.0, 300.0, inf)
    running, low, high, changes = -1.0, inf, -inf, 0
    for _time, readings in rows:
        on, current = readings[SWITCH], readings[CURRENT]
        if on is None or current is None:
            continue
        if on != running:
            running, changes = on, changes + 1
        if not low <= current < high:
            level = bisect_right(thresholds, current)
            low, high, changes = thresholds[level - 1], thresholds[level], changes + 1
    return changes


def bare_pass(trace: Trace) -> int:
    """The batch limit: see the module."""
    crossed = np.diff(trace.times) > DECANTER.gap
    for name, thresholds in ((SWITCH, (0.5,)), (CURRENT, (100.0, 200.0, 300.0))):
        for threshold in thresholds:
            above = trace.signals[name] >= threshold
            crossed |= above[1:] != above[:-1]
    return int(np.count_nonzero(crossed))


def measure(rows: int, streamed: int, repeats: int, seed: int) -> list[Figure]:
    """Both ways and both limits. Raises ValueError when they do not give the same events."""
    trace = long_trace(rows, seed)
    part = replace(
        trace, times=trace.times[:streamed], signals={n: column[:streamed] for n, column in trace.signals.items()}
    )
    given = as_rows(part)
    if tuple(stream(given)) != encode(part, DECANTER):
        raise ValueError("the encoder gives other events for a whole trace than for its rows")
    streaming, loop = best(lambda: stream(given), repeats), best(lambda: bare_loop(given), repeats)
    batch, arrays = best(lambda: encode(trace, DECANTER), repeats), best(lambda: bare_pass(trace), repeats)
    size, decided = part.times.size, best(lambda: bare_decisions(given), repeats)
    events = len(encode(trace, DECANTER))
    return [
        Figure("encoder, streaming", size / streaming, "samples/s", "empty Python loop over the rows", size / loop),
        Figure("encoder, streaming", size / streaming, "samples/s", "the bare comparisons in a loop", size / decided),
        Figure("encoder, batch", rows / batch, "samples/s", "numpy's comparisons alone", rows / arrays),
        Figure("  events in the batch", float(events), "", "rows", float(rows)),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="A tenth of the rows.")
@click.option("--rows", type=click.IntRange(100), help="Rows of the batch.")
@click.option("--repeats", type=click.IntRange(1), default=3, show_default=True, help="Repetitions; the best counts.")
@click.option("--seed", default=1, show_default=True, help="Seed of the synthetic day.")
def main(as_json: bool, quick: bool, rows: int | None, repeats: int, seed: int) -> None:
    wanted = rows or (ROWS // 10 if quick else ROWS)
    streamed = min(wanted, STREAMED // 10 if quick else STREAMED)
    give(f"encoder, {wanted:,} rows", measure(wanted, streamed, repeats, seed), as_json=as_json)


if __name__ == "__main__":
    main()
