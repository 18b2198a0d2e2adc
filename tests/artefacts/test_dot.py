"""The automaton's source in DOT."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.files import ArtefactError
from sim.lab.formats.foreign.convert import structure
from sim.lab.formats.foreign.dot import Source, SourceLocation, parse_source, source_text
from sim.sha.automaton import Edge, nondeterminism

PUBLIC = """digraph hybrid_automaton {
	edge [arrowsize=0.5]
	rankdir=LR size=2
	node [shape=circle]
	node [fontname=helvetica]
	node [penwidth=0.5]
	edge [fontname=helvetica]
	edge [penwidth=0.5]
	q_0 [label=<<FONT  POINT-SIZE="8" COLOR="black">q_0</FONT><br/><FONT  POINT-SIZE="6" COLOR="#ad0c00"><br/><b>f_0, D_0</b></FONT>>]
	q_1 [label=<<FONT  POINT-SIZE="8" COLOR="black">q_1</FONT><br/><FONT  POINT-SIZE="6" COLOR="#ad0c00"><br/><b>f_12, N_1</b></FONT>>]
	__init__ [label=<<FONT  POINT-SIZE="8" COLOR="black">__init__</FONT>>]
	q_0 -> q_1 [label=<<FONT  POINT-SIZE="8" COLOR="#008c05">T&lt;20</FONT><br/><FONT  POINT-SIZE="8" COLOR="#0067b0">c_0</FONT>>]
	q_0 -> q_0 [label=<<FONT  POINT-SIZE="8" COLOR="#0067b0">c_0</FONT>>]
	__init__ -> q_0 [label=<<FONT  POINT-SIZE="8" COLOR="#0067b0">h_0</FONT>>]
}
"""  # noqa: E501


def test_the_public_form_gives_flows_distributions_events_and_guards() -> None:
    source = parse_source(PUBLIC)
    assert source.locations == (
        SourceLocation("q_0", 0, "D_0"),
        SourceLocation("q_1", 12, "N_1"),
        SourceLocation("__init__"),
    )
    assert source.edges[0] == Edge("q_0", "c_0", "q_1", "T<20")
    assert source.edges[2] == Edge("__init__", "h_0", "q_0")


def test_the_public_form_is_written_back_byte_for_byte() -> None:
    assert source_text(parse_source(PUBLIC)) == PUBLIC


def test_several_targets_for_one_event_are_kept_and_reported() -> None:
    sha = structure(parse_source(PUBLIC), "x")
    assert nondeterminism(sha) == ["location 'q_0' has 2 targets on 'c_0': q_0, q_1"]


def test_any_valid_dot_is_read_whatever_its_layout() -> None:
    text = """/* made by hand */ STRICT Digraph "my graph" { // one line
      subgraph cluster_1 { "q 0" [color=red, label=<<font color="#AD0C00">f_1 , D_2</font>>]; node_1 }
      # a comment
      __init__; __init__ -> "q 0" -> node_1 [label = "go"][style=dashed] }"""
    source = parse_source(text)
    assert source.locations == (SourceLocation("q 0", 1, "D_2"), SourceLocation("node_1"), SourceLocation("__init__"))
    assert source.edges == (Edge("__init__", "go", "q 0"), Edge("q 0", "go", "node_1"))
    assert source.graph == "my graph"


labels = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Zl", "Zp"]), min_size=1, max_size=9).filter(
    lambda text: text == text.strip() and "\\" not in text and text.isprintable()
)


@st.composite
def sources(draw: st.DrawFn) -> Source:
    names = draw(st.lists(labels, min_size=1, max_size=5, unique=True))
    number = st.none() | st.integers(0, 99)
    law = st.none() | st.integers(0, 99).map("D_{}".format)
    ends = st.sampled_from(names)
    edges = draw(st.lists(st.builds(Edge, ends, labels, ends, st.none() | labels), max_size=6))
    return Source(tuple(SourceLocation(name, draw(number), draw(law)) for name in names), tuple(edges), draw(labels))


@settings(max_examples=40)
@given(sources())
def test_written_and_read_again_a_source_is_the_same(source: Source) -> None:
    assert parse_source(source_text(source)) == source


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("digraph x {\n a\n", 2, "the text ends too early"),
        ("graph x {\n a -- b\n}", 1, "unexpected 'graph x {'"),
        ("digraph x {\n a\n a -> b [label=e]\n}", 3, "leads to 'b', which is not defined"),
        ("digraph x {\n a\n\n a -> a\n}", 4, "has no event"),
        ("digraph x {\n a\n a\n}", 3, "a second time"),
        ('digraph x {\n a [label=<<font color="#ad0c00">f_1</font>>]\n}', 2, "like 'f_1, D_0'"),
        ("digraph x {\n a [label=<<b>x</b>]\n}", 2, "unexpected '<<b>x</b>]'"),
    ],
)
def test_what_is_wrong_in_a_source_is_told_with_its_line(text: str, line: int, reason: str) -> None:
    with pytest.raises(ArtefactError, match=rf"^f\.txt:{line}: ") as error:
        parse_source(text, "f.txt")
    assert reason in str(error.value)


def test_a_text_that_dot_cannot_hold_is_refused_and_never_written_differently() -> None:
    with pytest.raises(ArtefactError, match="cannot be a name in DOT"):
        source_text(Source((SourceLocation("a\\b"),), ()))
    with pytest.raises(ArtefactError, match="would lose its blanks"):
        source_text(Source((SourceLocation("a"),), (Edge("a", " e", "a"),)))


def test_subgraphs_may_nest_deeper_than_a_program_calls() -> None:
    depth = 1500
    nodes = "".join(f"subgraph s{number} {{ q_{number} " for number in range(depth))
    edges = "".join(f"q_{number} -> q_{number + 1} [label=a] " for number in range(depth - 1))
    source = parse_source(f"digraph x {{ {nodes} {'}' * depth} {edges} }}")
    assert [location.name for location in source.locations] == [f"q_{number}" for number in range(depth)]
    assert len(source.edges) == depth - 1
