"""Sets of artefacts: found by base name, turned into an automaton that can be run, written from a model."""

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.files import ArtefactError
from sim.lab.formats.foreign.bundle import Artefacts, read_artefacts, texts, write_artefacts
from sim.lab.formats.foreign.convert import Parameter, to_sha
from sim.lab.formats.foreign.dot import parse_source
from sim.lab.formats.foreign.flow_file import parse_flow_file
from sim.lab.formats.foreign.from_model import to_artefacts
from sim.lab.formats.foreign.histogram import parse_histogram
from sim.lab.formats.foreign.report import parse_report
from sim.sha.automaton import Distribution, Edge, Flow, Location
from sim.sha.model import Model
from tests.artefacts.models import decanter_model, models, normal

SOURCE = """digraph {
a [label=<<font color="#ad0c00">f_0, D_0</font>>]
b [label=<<font color="#ad0c00">f_1, D_1</font>>]
__init__
a -> b [label=go] b -> a [label=back] __init__ -> a [label=go] __init__ -> b [label=back] }"""
REPORT = "--LEARNED DISTRIBUTIONS--\nD_0(0.004)\nN_9(1, 4)\nD_1(0.02)\n"
FLOWS = "0\n(x0)' = 0.5 1 + -0.005 x0\n1\n(x0)' = 0.01\n"
VALUES = "D_0:\n0.003\n0.005\nD_1:\n0.02\nN_9:\n-1\n3\n"


def public(report: str = REPORT, flows: str = FLOWS, source: str = SOURCE, histogram: str = VALUES) -> Artefacts:
    return Artefacts(
        "x", parse_source(source), parse_report(report), parse_histogram(histogram), parse_flow_file(flows)
    )


def test_a_public_number_is_the_rate_of_a_first_order_flow_and_the_drift_of_a_linear_one() -> None:
    converted = to_sha(public())
    a, b, start = converted.sha.locations
    assert a.flow == Flow("exponential", {"k": 0.004, "m": 100.0, "noise": 0.0})
    assert (a.distribution, a.entry) == (normal(0.004, 0.001), "none")
    assert b == Location("b", Flow("linear", {"noise": 0.0}), normal(0.02, 0.0), "parameter")
    assert start == Location("__init__", Flow("constant", {"noise": 0.0}), None, "none")
    assert converted.sha.initial == "__init__"
    assert converted.notes == ("a: the rate is 0.004 1/s, the mean of D_0; the equation's is 0.005",)


def test_a_public_number_is_the_target_where_the_caller_says_so() -> None:
    a = to_sha(public(), parameter="target").sha.locations[0]
    assert a == Location("a", Flow("exponential", {"k": 0.005, "noise": 0.0}), normal(0.004, 0.001), "parameter")


def test_several_targets_are_kept_and_told() -> None:
    converted = to_sha(public(source=SOURCE.replace("a -> b", "a -> a [label=go] a -> b")))
    assert len(converted.sha.edges) == 5
    assert converted.notes[-1] == "location 'a' has 2 targets on 'go': a, b"


def test_a_histogram_that_contradicts_the_report_is_told() -> None:
    notes = to_sha(public(histogram="D_0:\n0.1\nD_1:\n0.02\nN_9:\n-1\n3\n")).notes
    assert notes[0] == "D_0: the mean of its 1 values is 0.1, the report says 0.004 (tolerance 1e-06)"


def test_a_line_of_the_thesis_says_that_x_is_drawn_on_entry() -> None:
    lines = "Location a: mu=23.5, sigma=1.2, flow=linear(alpha=0.05)\nLocation b: flow=constant\n"
    locations = to_sha(replace(public(report=lines), flows=None)).sha.locations
    assert locations[0] == Location("a", Flow("linear", {"m": 0.05, "noise": 0.0}), normal(23.5, 1.2), "resample")
    assert locations[1] == Location("b", Flow("constant", {"noise": 0.0}), None, "none")


def test_location_2_of_the_thesis_is_q_2_of_the_source() -> None:
    source = "digraph { q_2 __init__ __init__ -> q_2 }"
    sha = to_sha(public("Location 2: mu=20, sigma=1, flow=constant()\n", source=source)).sha
    assert (sha.initial, sha.locations[0].distribution) == ("q_2", normal(20.0, 1.0))


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (
            {"report": "--LEARNED DISTRIBUTIONS--\nD_0(0.004)\n"},
            "location 'b': the distribution D_1 is not in the report",
        ),
        ({"report": REPORT.replace("0.004", "-0.004")}, "cannot be an exponential flow's rate"),
        (
            {"flows": "0\n(x0)' = 1\n"},
            "location 'b': it follows flow 1, which flow_conditions.txt does not have (it has 0)",
        ),
        ({"flows": FLOWS.replace("0.01", "0.01 x0^2")}, "location 'b': flow 1: the term x0^2 is quadratic"),
        (
            {"source": SOURCE.replace("__init__ -> a [label=go]", "").replace("__init__ -> b [label=back]", "")},
            "no edge",
        ),
        ({"source": SOURCE.replace("__init__ -> a [label=go]", "__init__ -> a")}, "without an event beside others"),
        ({"source": SOURCE.replace("f_1, D_1", "ε, D_1")}, "never observed"),
        ({"report": "Location z: mu=1\n"}, "location 'z', which the source does not have"),
        ({"report": REPORT + "Location a: mu=1, flow=warp(x=2)\n"}, "the flow 'warp' is unknown; known are constant"),
        ({"report": REPORT + "Location a: mu=1, entry=sideways, flow=exponential(k=0.005, m=100)\n"}, "'sideways'"),
        ({"report": REPORT + "Location a: mu=1, flow=exponential(k=0.006, m=100)\n"}, "the flow file's 0 says"),
    ],
)
def test_what_cannot_be_run_is_refused_by_location_and_reason(changed: dict[str, str], reason: str) -> None:
    with pytest.raises(ArtefactError) as error:
        to_sha(public(**changed))
    assert reason in str(error.value)


def test_without_a_flow_file_the_structure_is_all_that_is_known() -> None:
    with pytest.raises(ArtefactError, match=r"location 'a': it follows flow 0, but there is no flow_conditions\.txt"):
        to_sha(replace(public(), flows=None))


@pytest.fixture
def written(tmp_path: Path) -> Path:
    write_artefacts(tmp_path, to_artefacts(decanter_model("CD_1"), {"off": [19.0, 21.0]}))
    return tmp_path


def test_a_set_is_read_as_it_was_written(written: Path) -> None:
    assert read_artefacts(written, "CD_1") == to_artefacts(decanter_model("CD_1"), {"off": [19.0, 21.0]})


def test_a_missing_file_is_told_before_any_is_opened_with_what_is_there(written: Path) -> None:
    (written / "CD_1.txt").unlink()
    (written / "CD_1_source.txt").write_text("this is no DOT")
    with pytest.raises(ArtefactError) as error:
        read_artefacts(written, "CD_1")
    assert "CD_1.txt is missing; the sets here are CD_1, with the files CD_1_histogram_values.txt" in str(error.value)


def test_upper_and_lower_case_count_and_the_other_spelling_is_named(written: Path) -> None:
    with pytest.raises(
        ArtefactError, match=r"cd_1_source\.txt is missing \(there is CD_1_source\.txt: upper and lower"
    ):
        read_artefacts(written, "cd_1")


def test_a_kind_that_may_be_missing_is_none(written: Path) -> None:
    (written / "flow_conditions.txt").unlink()
    assert read_artefacts(written, "CD_1", optional=["flows"]).flows is None
    with pytest.raises(ArtefactError, match=r"flow_conditions\.txt is missing"):
        read_artefacts(written, "CD_1", optional=["histogram"])
    with pytest.raises(ValueError, match="unknown kind of artefact 'flow'"):
        read_artefacts(written, "CD_1", optional=["flow"])


def test_a_directory_that_is_none_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="is no directory that can be read"):
        read_artefacts(tmp_path / "nowhere", "CD_1")
    (tmp_path / "file").write_text("")
    with pytest.raises(ArtefactError, match="cannot be written"):
        write_artefacts(tmp_path / "file", to_artefacts(decanter_model()))


@pytest.mark.parametrize("name", ["", "../x", "a/b", ".hidden", "x ", "a\nb"])
def test_a_name_that_is_no_file_name_is_refused(name: str) -> None:
    model = decanter_model()
    with pytest.raises(ArtefactError, match="cannot be a model's base name"):
        texts(to_artefacts(replace(model, sha=replace(model.sha, name=name))))


def test_the_artefacts_of_a_model_give_its_automaton_back() -> None:
    model = decanter_model()
    assert to_sha(to_artefacts(model)).sha == model.sha


@settings(max_examples=15, deadline=None)
@given(models(), st.sampled_from(["rate", "target"]))
def test_the_artefacts_of_any_model_read_back_as_its_automaton(model: Model, parameter: Parameter) -> None:
    written = texts(to_artefacts(model))
    name = model.sha.name
    read = Artefacts(
        name,
        parse_source(written[f"{name}_source.txt"]),
        parse_report(written[f"{name}.txt"]),
        parse_histogram(written[f"{name}_histogram_values.txt"]),
        parse_flow_file(written["flow_conditions.txt"]),
    )
    assert to_sha(read, parameter).sha == model.sha


def test_both_readers_find_the_mean_of_each_law() -> None:
    report = texts(to_artefacts(decanter_model()))["cd.txt"]
    section = report[report.index("--LEARNED DISTRIBUTIONS--\n") : report.index("--FINAL OBSERVATION TABLE--\n")]
    means = [float(line.split("(")[1].replace(")", "")) for line in section.splitlines() if line.startswith("D_")]
    assert means == [20.0, 40.0, 23.5, 3.0]
    assert "Location warm: mu=23.5, sigma=1.2, entry=resample, flow=linear(alpha=0.05, noise=0.0)\n" in report


def test_raw_values_stand_under_the_law_of_their_location() -> None:
    values = texts(to_artefacts(decanter_model(), {"on": [39.5, 40.5], "off": [20.0]}))["cd_histogram_values.txt"]
    assert values == "D_0:\n20.0\nD_1:\n39.5\n40.5\nD_2:\nD_3:\n"
    with pytest.raises(ArtefactError, match="location 'nowhere', which the automaton does not have"):
        to_artefacts(decanter_model(), {"nowhere": [1.0]})


def test_equal_laws_and_equal_equations_are_written_once() -> None:
    model = decanter_model()
    twin = replace(model.sha.locations[0], name="twin")
    sha = replace(
        model.sha, locations=(*model.sha.locations, twin), edges=(*model.sha.edges, Edge("twin", "A_0", "off"))
    )
    written = to_artefacts(replace(model, sha=sha))
    assert written.source.locations[5].flow == written.source.locations[0].flow == 0
    assert written.source.locations[5].distribution == "D_0"
    assert to_sha(written).sha == sha


def test_a_law_that_is_not_normal_keeps_its_kind() -> None:
    model = decanter_model()
    law = Distribution("weibull", {"shape": 2.0, "scale": 30.0})
    locations = (replace(model.sha.locations[0], distribution=law), *model.sha.locations[1:])
    changed = replace(model, sha=replace(model.sha, locations=locations))
    assert to_sha(to_artefacts(changed)).sha == changed.sha


def test_the_learners_own_location_names_can_be_written() -> None:
    model = decanter_model()
    names = dict(
        zip(("off", "on", "warm", "late", "held"), ("?", "ON/300+", "OFF/0-100", "a [b) & <c>", "{x}"), strict=True)
    )
    sha = replace(
        model.sha,
        locations=tuple(replace(place, name=names[place.name]) for place in model.sha.locations),
        edges=tuple(replace(edge, source=names[edge.source], target=names[edge.target]) for edge in model.sha.edges),
        initial="?",
    )
    written = texts(to_artefacts(replace(model, sha=sha)))
    read = Artefacts("cd", parse_source(written["cd_source.txt"]), parse_report(written["cd.txt"]))
    assert to_sha(read).sha == sha
