"""Hollow models: locations of the alphabet in which the traces hardly ever are, with the plant's bins and with auto.

Six signals of real recordings stand for the current of a motor that nobody has named thresholds for: SKAB's pump
(0.8 to 3.2 A), the engine speed of the cars over carOBD and CAN, the spindle of the CNC machine, the vibration of two
bearings. A bin counts as empty below 1 % of the readings, a model as hollow if half of its bins or more are, or if one
bin has over 95 % of the readings. Beside it, how far the automatic thresholds move when blocks of the recordings are
drawn anew (bootstrap, 5th to 95th percentile, as a share of the signal's range). Data: `../shared/data`.
"""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click
import numpy as np

from sim.lab.recordings import channel_uses, find_levels, load_map, load_traces
from sim.sha import DECANTER, Alphabet, Bins, Trace, encode

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data"
PLANT = next(channel.thresholds for channel in DECANTER.channels if isinstance(channel, Bins))
SETS = {
    "SKAB pump, current (A)": ("skab", "skab", "Assorbimento"),
    "carOBD, engine speed (rpm)": ("carobd", "carobd", "EngineSpeed"),
    "CAN, engine speed (rpm)": ("can_obd2", "can_obd2/tripA164_decoded_long.csv", "EngineSpeed"),
    "CNC, spindle speed (rpm)": ("made_cnc", "lsha_upstream/made_cnc", "SpindleSpeed"),
}
BEARINGS = {"FEMTO bearing 2_4, vibration (g)": "Bearing2_4", "FEMTO bearing 2_5, vibration (g)": "Bearing2_5"}
EMPTY, BLOCKS = 0.01, 50


@dataclass(frozen=True, slots=True)
class Hollowness:
    """A signal cut by some thresholds: bins, how many of them are empty, the share of the fullest one."""

    thresholds: tuple[float, ...]
    bins: int
    empty: int
    fullest: float

    @property
    def hollow(self) -> bool:
        """Whether a model of these bins is borrowed for the most part."""
        return self.bins > 1 and (2 * self.empty >= self.bins or self.fullest > 0.95)


def recorded() -> dict[str, tuple[list[Trace], str]]:
    """The recordings by name, with their signal. Raises ValueError where the data are absent."""
    sets = {}
    for name, (column_map, place, signal) in SETS.items():
        traces, _ = load_traces(DATA / place, load_map(ROOT / "config" / "traces" / f"{column_map}.toml"))
        sets[name] = (traces, signal)
    for name, bearing in BEARINGS.items():
        file = DATA / "femto_bearing" / f"{bearing}_vibrms_DERIVED.csv"
        level = np.loadtxt(file, delimiter=",", skiprows=1, usecols=6)
        sets[name] = ([Trace(bearing, np.arange(level.size) * 10.0, {"rms": level})], "rms")
    return sets


def hollowness(traces: Sequence[Trace], signal: str, thresholds: tuple[float, ...]) -> Hollowness:
    """How the readings fill the bins between the thresholds."""
    values = np.concatenate([trace.signals[signal] for trace in traces if signal in trace.signals])
    values = values[np.isfinite(values)]
    shares = np.bincount(np.searchsorted(thresholds, values, side="right"), minlength=len(thresholds) + 1) / values.size
    return Hollowness(thresholds, shares.size, int((shares < EMPTY).sum()), float(shares.max()))


def moved(traces: Sequence[Trace], signal: str, repeats: int, rng: np.random.Generator) -> tuple[float, float]:
    """(share of resamples with as many thresholds, spread of those thresholds as a share of the signal's range)."""
    whole = find_levels(traces, signal, 30.0).thresholds
    values = np.concatenate([trace.signals[signal] for trace in traces if signal in trace.signals])
    span = float(np.ptp(np.nanquantile(values, (0.01, 0.99))))
    drawn = []
    for _ in range(repeats):
        pieces = []
        for trace in traces:
            known = np.flatnonzero(np.isfinite(trace.signals.get(signal, np.empty(0))))
            blocks = [block for block in np.array_split(known, BLOCKS) if block.size > 1]
            for index in rng.integers(0, len(blocks), len(blocks)) if blocks else ():
                rows = blocks[index]
                pieces.append(Trace(trace.name, trace.times[rows], {signal: trace.signals[signal][rows]}))
        drawn.append(find_levels(pieces, signal, 30.0).thresholds)
    same = np.array([cuts for cuts in drawn if len(cuts) == len(whole)])
    if not len(whole) or not same.size:
        return len(same) / repeats, 0.0
    spread = np.ptp(np.quantile(same, (0.05, 0.95), axis=0), axis=0).max()
    return len(same) / repeats, float(spread / span)


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--repeats", type=click.IntRange(1), default=40, show_default=True, help="Resamples for each signal.")
@click.option("--seed", default=1, show_default=True, help="Seed of the resamples.")
def main(as_json: bool, repeats: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rows = []
    for name, (traces, signal) in recorded().items():
        plant = hollowness(traces, signal, PLANT)
        auto = hollowness(traces, signal, find_levels(traces, signal, 30.0).thresholds)
        encoded = Alphabet((Bins(signal, PLANT, ("A_0", "A_1", "A_2", "A_3")),))
        with_events = [Trace(each.name, each.times, each.signals, encode(each, encoded), each.bad) for each in traces]
        warned = any(use.sentence for use in channel_uses(with_events, encoded))
        same, spread = moved(traces, signal, repeats, rng)
        rows.append((name, plant, auto, warned, same, spread))
    counts = [sum(row[which].hollow for row in rows) for which in (1, 2)]
    silent = sum(plant.hollow and not warned for _, plant, _, warned, _, _ in rows)
    if as_json:
        table = [
            {
                "set": name,
                "plant": asdict(plant),
                "auto": asdict(auto),
                "warned": warned,
                "same": same,
                "spread": spread,
            }
            for name, plant, auto, warned, same, spread in rows
        ]
        click.echo(json.dumps({"sets": table, "hollow": counts, "silent": silent}))
        return
    for name, plant, auto, warned, same, spread in rows:
        cuts = ", ".join(f"{cut:g}" for cut in auto.thresholds) or "none"
        click.echo(
            f"{name}: plant's bins {plant.empty} of {plant.bins} empty, fullest {plant.fullest:.0%}"
            f"{' (hollow' + (', warned)' if warned else ')') if plant.hollow else ''}; auto ({cuts}) {auto.empty} of "
            f"{auto.bins} empty, fullest {auto.fullest:.0%}{' (hollow)' if auto.hollow else ''}; "
            f"resampled: as many thresholds {same:.0%}, spread {spread:.1%} of the range"
        )
    click.echo(f"hollow: {counts[0]} of {len(rows)} with the plant's bins ({silent} in silence), {counts[1]} with auto")


if __name__ == "__main__":
    main()
