"""The automata that the public learner wrote: each becomes one that can be run, or is refused with a reason."""

import warnings
from pathlib import Path

import pytest

from sim.files import ArtefactError
from sim.lab.formats.foreign.bundle import KINDS, SUFFIXES, read_artefacts, texts
from sim.lab.formats.foreign.convert import structure, to_sha
from sim.lab.formats.foreign.dot import read_source
from sim.lab.formats.foreign.histogram import distinct_runs, evidence, read_histogram
from sim.sha.automaton import nondeterminism
from tests.artefacts.real import SETS, real_data

pytestmark = real_data

OUTCOMES = {
    "THERMO_UPPAAL_1": (2, 3, "location 'q_0': it follows flow 0, but there is no flow_conditions.txt"),
    "THERMO_UPPAAL_2": (4, 10, "location 'q_0': it follows flow 0, but there is no flow_conditions.txt"),
    "THERMO_UPPAAL_3": (6, 21, "location 'q_0': it follows flow 0, but there is no flow_conditions.txt"),
    "THERMO_UPPAAL_4": (5, 12, "location 'q_0': it follows flow 0, but there is no flow_conditions.txt"),
    "THERMO_UPPAAL_5": (5, 12, "location 'q_0': it follows flow 0, but there is no flow_conditions.txt"),
    "HRI_SIM_3a": (7, 7, "location 'q_0': it follows flow 14, but there is no flow_conditions.txt"),
    "HRI_SIM_3b": (3, 5, None),
    "ENERGY_MADE_1": (19, 29, "location 'q_0': flow 1: the term P^2 is quadratic in the state; the flow library has"),
}
"""Locations without `__init__`, edges, and why no automaton that can be run comes of it (None: one does)."""

MISSING = {name: ["flow_conditions.txt"] for name in ("HRI_SIM_3a",)} | {
    f"THERMO_UPPAAL_{number}": [f"THERMO_UPPAAL_{number}_histogram_values.txt", "flow_conditions.txt"]
    for number in range(1, 6)
}


def test_no_set_is_forgotten() -> None:
    root = SETS["THERMO_UPPAAL_1"]
    found = {path.name.removesuffix(SUFFIXES["source"]) for path in root.rglob(f"*{SUFFIXES['source']}")}
    assert found <= set(SETS)


@pytest.mark.parametrize("name", SETS)
def test_every_set_loads_or_its_missing_files_are_named(name: str) -> None:
    if name not in MISSING:
        assert read_artefacts(SETS[name], name).flows is not None
        return
    with pytest.raises(ArtefactError) as error:
        read_artefacts(SETS[name], name)
    assert all(f"{file} is missing" in str(error.value) for file in MISSING[name])


@pytest.mark.parametrize("name", SETS)
def test_every_set_becomes_an_automaton_or_is_refused_with_the_expected_reason(name: str) -> None:
    artefacts = read_artefacts(SETS[name], name, optional=["histogram", "flows"])
    locations, edges, reason = OUTCOMES[name]
    assert len(artefacts.source.locations) == locations + 1
    assert len(structure(artefacts.source, name).edges) == edges
    if reason is None:
        assert len(to_sha(artefacts).sha.locations) == locations + 1
        return
    with pytest.raises(ArtefactError) as error:
        to_sha(artefacts)
    assert reason in str(error.value)


@pytest.mark.parametrize("name", SETS)
def test_every_file_of_every_set_is_written_back_byte_for_byte(name: str) -> None:
    artefacts = read_artefacts(SETS[name], name, optional=KINDS)
    for file, text in texts(artefacts).items():
        assert text.encode() == (SETS[name] / file).read_bytes(), file


@pytest.mark.parametrize("name", SETS)
def test_another_dot_parser_finds_the_same_nodes_and_edges(name: str) -> None:
    pydot = pytest.importorskip("pydot")
    path = SETS[name] / f"{name}_source.txt"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about that parser's own grammar
        (graph,) = pydot.graph_from_dot_data(path.read_text(encoding="utf-8"))
    source = read_source(path)
    nodes = [node.get_name() for node in graph.get_nodes() if node.get_name() not in ("node", "edge", "graph")]
    assert nodes == [location.name for location in source.locations]
    ends = [(edge.get_source(), edge.get_destination()) for edge in graph.get_edges()]
    assert sorted(ends) == sorted((edge.source, edge.target) for edge in source.edges)


def test_no_real_source_is_non_deterministic_here() -> None:
    for name, directory in SETS.items():
        source = read_source(directory / f"{name}_source.txt")
        assert nondeterminism(structure(source, name)) == []


@pytest.mark.parametrize(
    ("name", "runs", "distinct"), [("HRI_SIM_3a", 1, 1), ("HRI_SIM_3b", 119, 10), ("ENERGY_MADE_1", 1, 1)]
)
def test_the_report_agrees_with_the_last_run_of_the_real_histograms(name: str, runs: int, distinct: int) -> None:
    artefacts = read_artefacts(SETS[name], name, optional=["flows"])
    assert artefacts.histogram is not None
    found = evidence(artefacts.histogram, artefacts.report.distributions)
    assert (found.runs, found.distinct, found.origin, found.disagreements) == (runs, distinct, "the last run", ())


def test_the_appended_histogram_has_as_many_runs_and_headers_as_stated() -> None:
    path: Path = SETS["HRI_SIM_3b"] / "HRI_SIM_3b_histogram_values.txt"
    histogram = read_histogram(path)
    assert sum(len(run) for run in histogram.runs) == 556
    assert {name for run in histogram.runs for name in run} == {f"D_{number}" for number in range(7)}
    last = histogram.runs[-1]
    assert sum(dict(run) == dict(last) for run in histogram.runs) == 28
    assert len(distinct_runs(histogram)) == 10
