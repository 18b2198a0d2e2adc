"""The raw values behind the distributions, in a file that repeated runs append to."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.files import ArtefactError
from sim.lab.formats.foreign.histogram import (
    Histogram,
    disagreements,
    distinct_runs,
    evidence,
    fit_values,
    histogram_text,
    merge,
    parse_histogram,
)
from sim.lab.formats.foreign.report import ReportedLaw

ONE = "D_0:\n1.0\n3.0\nD_1:\n0.5\n"
OTHER = "D_0:\n10.0\nD_1:\n0.7\n"


def laws(*means: float) -> tuple[ReportedLaw, ...]:
    return tuple(ReportedLaw(f"D_{index}", mean) for index, mean in enumerate(means))


def test_a_header_that_starts_again_begins_the_next_run() -> None:
    histogram = parse_histogram(ONE + OTHER + "D_0:\n2.0\n")
    assert [dict(run) for run in histogram.runs] == [
        {"D_0": (1.0, 3.0), "D_1": (0.5,)},
        {"D_0": (10.0,), "D_1": (0.7,)},
        {"D_0": (2.0,)},
    ]


def test_a_run_appended_again_counts_once_even_in_another_order() -> None:
    histogram = parse_histogram(ONE * 3 + "D_0:\n3.0\n1.0\nD_1:\n0.5\n")
    assert len(histogram.runs) == 4
    assert len(distinct_runs(histogram)) == 1
    assert merge(histogram) == {"D_0": (1.0, 3.0), "D_1": (0.5,)}
    assert fit_values(merge(histogram)["D_0"]).count == 2


def test_different_runs_are_merged_by_distribution() -> None:
    assert merge(parse_histogram(ONE + OTHER + ONE)) == {"D_0": (1.0, 3.0, 10.0), "D_1": (0.5, 0.7)}


def test_the_run_that_the_report_describes_is_the_evidence_wherever_it_stands() -> None:
    histogram = parse_histogram(ONE + OTHER)
    last, first = evidence(histogram, laws(10.0, 0.7)), evidence(histogram, laws(2.0, 0.5))
    pooled = evidence(histogram, laws(14.0 / 3.0, 0.6))
    assert (last.values["D_0"], last.origin) == ((10.0,), "the last run")
    assert first.values["D_0"] == (1.0, 3.0)
    assert pooled.values["D_0"] == (1.0, 3.0, 10.0)
    assert (pooled.runs, pooled.distinct, pooled.disagreements) == (2, 2, ())


def test_a_report_that_no_run_agrees_with_is_told_for_each_distribution() -> None:
    found = evidence(parse_histogram(ONE), laws(2.0, 0.6, 9.0))
    assert found.disagreements == (
        "D_1: the mean of its 1 values is 0.5, the report says 0.6 (tolerance 1e-06)",
        "D_2 is in the report but has no values",
    )


def test_the_six_printed_decimals_are_no_disagreement_and_a_wrong_variance_is_one() -> None:
    values = {"D_0": (1.0, 2.0, 4.0)}
    assert disagreements(values, (ReportedLaw("D_0", 2.333333, 1.555556),)) == ()
    assert "variance" in disagreements(values, (ReportedLaw("D_0", 2.333333, 2.0),))[0]
    assert "mean" in disagreements(values, (ReportedLaw("D_0", 2.33334),))[0]


def test_values_that_the_learner_repeats_do_not_change_the_fit() -> None:
    once, often = fit_values((1.0, 3.0)), fit_values((1.0, 3.0) * 6)
    assert (often.mean, often.sigma, often.distinct) == (once.mean, once.sigma, once.distinct) == (2.0, 1.0, 2)
    with pytest.raises(ValueError, match="without values"):
        fit_values(())


@settings(max_examples=60)
@given(
    st.lists(
        st.lists(
            st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=4).map(tuple), min_size=1, max_size=4
        ),
        max_size=4,
    )
)
def test_written_and_read_again_a_histogram_is_the_same(runs: list[list[tuple[float, ...]]]) -> None:
    histogram = Histogram(tuple({f"D_{index}": values for index, values in enumerate(run)} for run in runs))
    assert parse_histogram(histogram_text(histogram)) == histogram


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("D_0:\n1.0\nnan\n", 3, "'nan'; a finite number is needed"),
        ("D_0:\n-inf\n", 2, "'-inf'; a finite number is needed"),
        ("D_0:\n1.0\n\nabc\n", 4, "'abc', which is no number"),
        ("1.0\nD_0:\n", 1, "stands before any header"),
        ("D_0:\n1,5\n", 2, "'1,5', which is no number"),
    ],
)
def test_what_is_wrong_in_a_histogram_is_told_with_its_line(text: str, line: int, reason: str) -> None:
    with pytest.raises(ArtefactError, match=rf"^h\.txt:{line}: ") as error:
        parse_histogram(text, "h.txt")
    assert reason in str(error.value)
