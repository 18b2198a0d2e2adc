"""The learner's report, in the public learner's and the thesis's form."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.files import ArtefactError
from sim.lab.formats.foreign.report import (
    Report,
    ReportedLaw,
    ReportedLocation,
    ReportRow,
    Table,
    parse_report,
    report_text,
)

PUBLIC = """--EVENT LABELS DICT--

s1: Sensor 1


--OBSERVABLE EVENTS--

h_0: !open,on
m_66: 6700<=w<6800,start
i_0: stop


--LEARNED DISTRIBUTIONS--

D_0(1.000003)
N_1(-0.500000, 0.250000)


--FINAL OBSERVATION TABLE--

       |ε        |i_0      
-------+---------+---------
h_0    |(f_1,D_0)|(ε,ε)    
h_0m_66|(f_1,N_1)|(f_0,D_0)
-------+---------+---------
h_0i_0 |(f_0,D_0)|(ε,ε)    
-------+---------+---------



--PERFORMANCE DATA--

SAMPLED TRACES:	50
RUNNING TIME:	1 day, 0:00:08.035976
"""  # noqa: W291


def test_every_section_of_the_public_form_is_read() -> None:
    report = parse_report(PUBLIC)
    assert report.labels == (("s1", "Sensor 1"),)
    assert report.events[1] == ("m_66", "6700<=w<6800,start")
    assert report.distributions == (ReportedLaw("D_0", 1.000003), ReportedLaw("N_1", -0.5, 0.25))
    assert report.table == Table(
        ("ε", "i_0"),
        (ReportRow("h_0", ("(f_1,D_0)", "(ε,ε)")), ReportRow("h_0m_66", ("(f_1,N_1)", "(f_0,D_0)"))),
        (ReportRow("h_0i_0", ("(f_0,D_0)", "(ε,ε)")),),
    )
    assert report.performance[1] == ("RUNNING TIME", "1 day, 0:00:08.035976")


def test_the_public_form_is_written_back_byte_for_byte() -> None:
    assert report_text(parse_report(PUBLIC)) == PUBLIC


def test_the_lines_of_the_thesis_are_read_without_any_header() -> None:
    report = parse_report("Location 2: mu=23.5, sigma=1.2, flow=linear(alpha=0.05)\n")
    assert report.locations == (
        ReportedLocation("2", {"mu": 23.5, "sigma": 1.2}, {"flow": ("linear", {"alpha": 0.05})}),
    )


def test_windows_line_ends_and_a_missing_last_newline_change_nothing() -> None:
    assert parse_report(PUBLIC.replace("\n", "\r\n").rstrip()) == parse_report(PUBLIC)


finite = st.floats(allow_nan=False, allow_infinity=False).map(lambda value: value + 0.0)
words = st.from_regex(r"[a-z]{1,3}_[0-9]{1,2}", fullmatch=True)
cells = st.sampled_from(["(ε,ε)", "(f_1,D_0)", "(f_12,N_3);(f_0,D_2)"])


@st.composite
def tables(draw: st.DrawFn) -> Table:
    columns = draw(st.integers(1, 3))
    row = st.builds(ReportRow, words, st.tuples(*[cells] * columns))
    suffixes = tuple(draw(st.lists(words, min_size=columns, max_size=columns)))
    return Table(suffixes, tuple(draw(st.lists(row, max_size=3))), tuple(draw(st.lists(row, max_size=3))))


@st.composite
def reports(draw: st.DrawFn) -> Report:
    symbols = draw(st.lists(words, max_size=4, unique=True))
    laws = st.builds(ReportedLaw, words, finite, st.none() | finite.map(abs))
    location = st.builds(
        ReportedLocation,
        words,
        st.fixed_dictionaries({"mu": finite, "sigma": finite, "entry": st.sampled_from(["parameter", "resample"])}),
        st.dictionaries(st.sampled_from(["flow", "law"]), st.tuples(words, st.dictionaries(words, finite, max_size=2))),
    )
    return Report(
        events=tuple((symbol, draw(st.sampled_from(["", "100<=w<200,start", "stop"]))) for symbol in symbols),
        distributions=tuple(draw(st.lists(laws, max_size=4, unique_by=lambda law: law.name))),
        table=draw(st.none() | tables()),
        performance=tuple((symbol, "50") for symbol in symbols),
        locations=tuple(draw(st.lists(location, max_size=3, unique_by=lambda line: line.name))),
        limits=draw(st.just({}) | st.fixed_dictionaries({"low": finite, "max_rate": finite | st.just(float("inf"))})),
    )


@settings(max_examples=40)
@given(reports())
def test_written_and_read_again_a_report_is_the_same(report: Report) -> None:
    assert parse_report(report_text(report)) == report


LAWS = "--LEARNED DISTRIBUTIONS--\n\n"


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (LAWS + "D_0(abc)\n", 3, "the mean of D_0 is 'abc', which is no number"),
        (LAWS + "D_0(nan)\n", 3, "a finite number is needed"),
        (LAWS + "N_0(1, -2)\n", 3, "cannot be negative"),
        (LAWS + "D_0 1.5\n", 3, "unexpected 'D_0 1.5'"),
        (LAWS + "D_0(1)\nD_0(2)\n", 4, "D_0 stands here a second time"),
        (LAWS + "D_0(1)\n\n" + LAWS, 5, "a second time"),
        ("--NEW SECTION--\n", 1, "--OBSERVABLE EVENTS--"),
        ("Location 2: mu=x\n", 1, "mu is 'x', which is no number"),
        ("Location 2: mu=1, mu=2\n", 1, "given twice"),
        ("Location 2: mu=1\nLocation 2: mu=1\n", 2, "a second time"),
        ("--FINAL OBSERVATION TABLE--\n |ε|a\n--+-+-\nb|(ε,ε)\n--+-+-\n", 4, "has 1 cells; the table has 2 columns"),
        ("--FINAL OBSERVATION TABLE--\n |ε\n--+-\nb|f_1\n--+-\n", 4, "the row of b has the cell 'f_1'; write one like"),
    ],
)
def test_what_is_wrong_in_a_report_is_told_with_its_line(text: str, line: int, reason: str) -> None:
    with pytest.raises(ArtefactError, match=rf"^r\.txt:{line}: ") as error:
        parse_report(text, "r.txt")
    assert reason in str(error.value)


def test_a_symbol_with_a_blank_inside_stays_one_word() -> None:
    table = Table(("ε", "load it"), (ReportRow("load it", ("(f_0,D_0)", "(ε,ε)")),))
    assert parse_report(report_text(Report(table=table))).table == table
