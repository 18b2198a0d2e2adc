"""What it costs that rates are the same for all machines in a model, on machines whose rates differ (record 0013).

Nine synthetic machines relax at rates that scatter by a given share; a model of six of them forecasts the other three
as the gateway does, events to come unknown. It stands against models that each of the three taught itself in other
cycles: what could be gained by knowing the own rate.
"""

from dataclasses import replace
from math import exp

import click
import numpy as np

from benchmarks.figures import Figure, give
from gateway.machine.model import forecast_trace
from gateway.settings import EnsembleSection, ForecastSection
from sim.forecast import FAN_LEVELS
from sim.lab.learning.bins import learn_bins
from sim.sha import DECANTER, Model, Trace
from tests.learning.plants import Truth, simulate

HORIZONS = (60.0, 300.0, 900.0)
MACHINES, KNOWN, CYCLES = 9, 6, 2
PERIOD = 5.0
FORECASTS = ForecastSection(horizons=HORIZONS, period=60.0, runs=256)


def cycles_of(machine: int, factor: float, seed: int) -> list[Trace]:
    """Cycles of a machine whose rates are `factor` times those of the plant."""
    truth = Truth(tau=(600.0 / factor, 600.0 / factor))
    traces = simulate(truth, MACHINES * seed + machine, cycles=CYCLES, rows=600, hold=40)
    return [replace(trace, name=f"{machine}-{trace.name}", machine=f"machine {machine}") for trace in traces]


def scored(model: Model, traces: list[Trace]) -> list[tuple[float, float, bool]]:
    """(horizon, error in degC, held by the 90 % band) of every forecast along the traces."""
    found = []
    for trace in traces:
        for forecast in forecast_trace(
            [model], trace, FORECASTS, ensemble=EnsembleSection(), scan_period=PERIOD, levels=FAN_LEVELS
        ):
            for number, horizon in enumerate(HORIZONS):
                row = int(np.searchsorted(trace.times, forecast.time + horizon))
                if row < trace.times.size:
                    low, middle, high = (
                        float(forecast.quantiles[FAN_LEVELS.index(level), number]) for level in (0.05, 0.5, 0.95)
                    )
                    outcome = trace.signals["T"][row]
                    found.append((horizon, abs(float(outcome - middle)), bool(low <= outcome <= high)))
    return found


def measure(scatter: float, seed: int) -> list[Figure]:
    """The figures where log(rate) scatters by `scatter` between machines."""
    factors = [exp(scatter * step) for step in np.random.default_rng(seed).standard_normal(MACHINES)]
    cycles = [cycles_of(machine, factor, seed) for machine, factor in enumerate(factors)]
    common = learn_bins([trace for own in cycles[:KNOWN] for trace in own], DECANTER, "T", seed=0).model
    rows, own_rows = [], []
    for machine in range(KNOWN, MACHINES):
        rows += scored(common, cycles[machine])
        taught = learn_bins(cycles_of(machine, factors[machine], seed + 1), DECANTER, "T", seed=0).model
        own_rows += scored(taught, cycles[machine])
    figures = []
    for horizon in HORIZONS:
        here, own = ([row for row in each if row[0] == horizon] for each in (rows, own_rows))
        name = f"rates scatter by {scatter:.0%}, {horizon:g} s"
        error, other = (float(np.mean([row[1] for row in each])) for each in (here, own))
        figures.append(Figure(f"{name}: mean error", error, "degC", "a model of the machine itself", other))
        figures.append(Figure("  held by the 90 % band", float(np.mean([row[2] for row in here])), ""))
    return figures


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="Only machines whose rates scatter by 40 %.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Of the machines.")
def main(as_json: bool, quick: bool, seed: int) -> None:
    figures = [figure for scatter in ((0.4,) if quick else (0.0, 0.2, 0.4)) for figure in measure(scatter, seed)]
    give("machines that differ in their rates", figures, as_json=as_json)


if __name__ == "__main__":
    main()
