"""Real machining cycles, with their own alphabets of spindle speeds, are exported and replayed event by event."""

from pathlib import Path

import pytest

from gateway.console.places import shipped_file
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.lab.uppaal.model_export import export
from sim.sha.automaton import SHA, Distribution, Edge, Flow, Location
from sim.sha.events import alphabet_symbols
from sim.sha.model import Model
from sim.sha.trace import UNKNOWN
from tests.uppaal.interpreter import Network
from tests.uppaal.support import courses, middle

DATA = Path(__file__).parents[3] / "shared" / "data" / "lsha_upstream" / "made_cnc"


@pytest.mark.real_data
def test_a_machining_cycle_is_replayed_whole() -> None:
    if not DATA.is_dir():
        pytest.skip("needs ../shared/data/lsha_upstream/made_cnc")
    column_map = load_map(shipped_file("traces", "made_cnc"))
    files = sorted(str(path) for path in DATA.glob("*.csv"))[:2]
    traces, _ = load_traces(files, column_map)
    assert traces
    law, flow = Distribution("normal", {"mu": 3.0, "sigma": 0.3}), Flow("exponential", {"k": 0.05, "noise": 0.1})
    symbols = [symbol for symbol in alphabet_symbols(column_map.alphabet) if symbol != UNKNOWN]
    places = tuple(Location(symbol, flow, law) for symbol in symbols)
    for trace in traces:
        path = [symbols[0], *(event.symbol for event in trace.events)]
        path = [symbols[0] if symbol == UNKNOWN else symbol for symbol in path]
        steps = zip(path[:-1], [event.symbol for event in trace.events], path[1:], strict=True)
        edges = tuple(dict.fromkeys(Edge(*step) for step in steps if step[1] != UNKNOWN))
        model = Model(SHA("cnc", places, edges, symbols[0]), column_map.alphabet, column_map.temperature, 0.0)
        exported = export(model, trace, tick=0)
        network, _ = courses(exported.main.xml, exported.replay.duration, middle, most=60.0)
        assert network.by_name["m_1"].own["taken"] == len(exported.replay.times) > 5
        minimal = Network(exported.minimal.xml, middle)
        minimal.settle()
        assert minimal.by_name["p_1"].own["next_i"] == len(trace.events)
