"""One law for what a model has written as a line for each bin: seen in its constants, and not where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from sim.lab.discrepancy.constants import find_absorbed_law
from sim.lab.discrepancy.fitting.baseline import build_frame, move_frame
from sim.lab.discrepancy.fitting.free_run_fit import fit
from sim.lab.discrepancy.fitting.record import build_record
from sim.lab.discrepancy.rules import RULES
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Input, Location
from sim.sha.events import Alphabet, Bins, Switch, encode
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN, Array, Trace

SYMBOLS = ("A_0", "A_1", "A_2")
ALPHABET = Alphabet(
    (Switch("MarciaDecanter", "W_ON", "W_OFF"), Bins("Assorbimento", (150.0, 250.0), SYMBOLS)), gap=600.0
)
RATE, PERIOD = 1 / 1500.0, 60.0


def three_lines() -> Model:
    """A target and a gain for each bin of the current."""
    names = ("OFF", *SYMBOLS)
    edges = [Edge(source, symbol, symbol) for source in SYMBOLS for symbol in SYMBOLS]
    edges += [Edge("OFF", symbol, "OFF") for symbol in SYMBOLS] + [Edge("OFF", "W_ON", "A_0")]
    edges += [Edge(source, symbol, "OFF") for source in names for symbol in ("W_OFF", UNKNOWN)]
    running = [
        Location(
            symbol,
            Flow("driven", {"k": RATE, "noise": 0.002}, (Input("Assorbimento", gain, middle),)),
            Distribution("normal", {"mu": target, "sigma": 0.5}),
        )
        for symbol, gain, middle, target in zip(
            SYMBOLS, (0.08, 0.16, 0.24), (100.0, 200.0, 300.0), (26.0, 38.0, 58.0), strict=True
        )
    ]
    off = Location(
        "OFF", Flow("exponential", {"k": 1 / 3600, "noise": 0.002}), Distribution("normal", {"mu": 17.0, "sigma": 0.5})
    )
    return Model(SHA("lines", (off, *running), tuple(edges), "OFF"), ALPHABET, "T", 0.05)


def measured(law: dict[str, float], seed: int) -> Trace:
    """Two days of five runs each under a heat a + b I + c I^2 (degC of target), with `steps` in the bins at will.

    A pump that takes `pump` degC away runs in strokes of a minute, half of the time in the middle bin, three quarters
    in the upper one.
    """
    rng = np.random.default_rng(seed)
    size = int(2 * 86400 / PERIOD)
    hour = 3600 / PERIOD
    phase = np.arange(size) % int(4.5 * hour)
    on = (phase > 1.2 * hour).astype(float)
    # It starts without a load, as the automaton believes.
    current = np.where(phase < 1.5 * hour, 100.0, np.repeat(rng.uniform(80.0, 340.0, size // 15 + 1), 15)[:size])
    stroke = np.arange(size) % 4
    pumping = np.where(current > 250.0, stroke < 3, np.where(current > 150.0, stroke < 2, False)) * on
    x, course = 17.0, np.empty(size)
    for row in range(size):
        course[row] = x
        amp = current[row]
        target = law["a"] + law["b"] * amp + law["c"] * amp**2 + law["steps"] * (150.0 < amp < 250.0)
        target -= law["pump"] * pumping[row]
        k, aim = (RATE, target) if on[row] else (1 / 3600, 17.0)
        x = aim + (x - aim) * np.exp(-k * PERIOD)
    read: Array = course + 0.05 * rng.standard_normal(size)
    trace = Trace(
        "lines",
        PERIOD * np.arange(size),
        {"MarciaDecanter": on, "Assorbimento": current, "MarciaPmpFango": pumping, "T": read},
    )
    return replace(trace, events=encode(trace, ALPHABET))


@pytest.mark.parametrize(
    ("law", "name"),
    [
        ({"a": 22.0, "b": 0.0, "c": 4e-4, "steps": 0.0, "pump": 0.0}, "quadratic-current-heating"),
        ({"a": 20.0, "b": 0.1, "c": 0.0, "steps": 0.0, "pump": 0.0}, "current-heating"),
        ({"a": 20.0, "b": 0.1, "c": 0.0, "steps": 3.0, "pump": 0.0}, None),
        ({"a": 20.0, "b": 0.1, "c": 0.0, "steps": 0.0, "pump": 4.0}, "current-heating and pump-cooling"),
        ({"a": 22.0, "b": 0.0, "c": 4e-4, "steps": 0.0, "pump": 2.0}, "quadratic-current-heating and pump-cooling"),
    ],
)
def test_the_law_behind_the_lines_is_told_where_there_is_one(law: dict[str, float], name: str | None) -> None:
    record = build_record(three_lines(), [measured(law, 1)], ("Assorbimento", "MarciaPmpFango"))
    last = np.unique(record.cycle)[-3]
    fitted = fit(move_frame(build_frame(record), record.select(record.cycle < last)))
    held_out = record.select(record.cycle >= last).by_cycles()
    found = find_absorbed_law(fitted, "Assorbimento", held_out, RULES, pump="MarciaPmpFango")
    assert (found.name if found else None) == name
    if found:
        assert found.instead == len(found.coefficients) < found.constants == 6
        assert found.coefficients[2 if law["b"] and law["c"] else 1] == pytest.approx(law["c"] or law["b"], rel=0.02)
        if law["pump"]:
            assert found.coefficients[-1] == pytest.approx(-law["pump"], rel=0.1)
        assert found.rmse_after <= 1.1 * found.rmse_before
