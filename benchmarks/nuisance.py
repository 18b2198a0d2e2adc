"""How often the anomaly alarm comes where nothing is wrong, by its limit: `python -m benchmarks.nuisance`.

Models of every other recording, followed along the others of the same plants as a gateway follows them; nothing is
broken in any. Prints the alarms an hour of operation at each limit.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import numpy as np

from benchmarks.figures import Figure, give
from gateway.machine.model import recorded_scans
from gateway.machine.model.predict import Predictor
from gateway.settings import AlarmSection
from gateway.settings.alarm_kinds import ANOMALY_DEADBAND_SHARE
from sim.lab.learning.bins import learn_bins
from sim.lab.recordings import load_map, load_traces
from sim.plant import SCENARIOS, scenario
from sim.sha import DECANTER, Alphabet, Model, Trace

MAPS = Path(__file__).parents[1] / "config" / "traces"
SHARED = Path(__file__).parents[2] / "shared" / "data"
LIMITS = (3.0, 5.0, AlarmSection().anomaly)


def plants() -> Iterator[tuple[str, Alphabet, str, Sequence[Trace]]]:
    """(name, alphabet, temperature, recordings without a fault); measured ones where they are at hand."""
    yield "decanter (synthetic)", DECANTER, "TCuscinettiRiduttore", [scenario(name) for name in SCENARIOS]
    for name in ("carobd", "skab"):
        folder = SHARED / name
        if folder.is_dir():
            column_map = load_map(MAPS / f"{name}.toml")
            traces = [trace for trace in load_traces([str(folder)], column_map)[0] if trace.times.size > 50]
            if len(traces) == 1:  # one recording: its second half is judged
                middle = float(traces[0].times[traces[0].times.size // 2])
                traces = [traces[0].between(-np.inf, middle), traces[0].between(middle, np.inf)]
            yield name, column_map.alphabet, column_map.temperature, traces


def alarms(model: Model, trace: Trace) -> dict[float, int]:
    """How often the alarm would be raised along a trace at each of LIMITS."""
    period = max(1.0, float(np.median(np.diff(trace.times))))
    predictor, counts, standing = Predictor(model, model.temperature), dict.fromkeys(LIMITS, 0), set[float]()
    for scan in recorded_scans(trace, period, model.alphabet):
        found = predictor.step(scan)
        if not (found.known and found.inputs_good):
            continue
        for limit in LIMITS:
            if limit not in standing and found.anomaly > limit:
                standing.add(limit)
                counts[limit] += 1
            elif found.anomaly <= limit * (1.0 - ANOMALY_DEADBAND_SHARE):
                standing.discard(limit)
    return counts


@click.command()
@click.option("--json", "as_json", is_flag=True, help="One line of JSON instead of a table.")
def main(as_json: bool) -> None:
    """Learn from one half of the recordings and follow the other."""
    rows = []
    for name, alphabet, temperature, traces in plants():
        model = learn_bins(traces[::2], alphabet, temperature, name=name, seed=0, bands=False).model
        held_out = traces[1::2]
        hours = sum(float(trace.times[-1] - trace.times[0]) for trace in held_out) / 3600.0
        found = [alarms(model, trace) for trace in held_out]
        for limit in LIMITS:
            count = sum(each[limit] for each in found)
            what = f"{name}: anomaly alarms at {limit:g} in {hours:.1f} h"
            rows.append(Figure(what, count, "alarms"))
    give("anomaly alarms where nothing is wrong", rows, as_json=as_json)


if __name__ == "__main__":
    main()
