"""What verifyta prints is read as it is printed, by 4.1.26 and by 5.0; what is not its output is said to be so."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.lab.uppaal.output import ValueHistogram, failure, parse_output

# The forms of 4.1.26 (-u) and 5.0 after published logs and parsers, figures and names changed; the lines of courses
# and the H0 line are composed after the manual.
OLD = """\
Options for the verification:
  Generating no trace
  Search order is breadth first
  Using conservative space optimisation
  Seed is 1685907555
  State space representation uses minimal constraint systems
\x1b[2K
Verifying formula 1 at /nta/queries/query[1]/formula
\x1b[2K -- Formula is satisfied.
(10000 runs) E(max) = 4.5129
Values in [3,9] mean=4.5129 steps=1: 1360 3809 3472 1090 242 24 3
 -- States explored : 5242112 states
 -- CPU user time used : 20020 ms

\x1b[2K
Verifying formula 2 at /nta/queries/query[2]/formula
 -- Throughput: 123540 states/sec, Load: 100 iterations\x1b[K
\x1b[2K -- Formula is satisfied.
(29 runs) Pr(<> ...) in [0,0.0981446]
with confidence 0.95.
\x1b[2K
Verifying formula 3 at q.q:3
\x1b[2K -- Formula is NOT satisfied.
"""

NEW = """\
Verifying formula 1 at query.q:2
 -- Formula is satisfied.
m_1.Temp:
[0]: (0,18.2) (5,18.9) (5,19.25) (12.5,1e1)
[1]: (0,18.2) (4.75,18.5)
p_1.next_i:
[0]: (0,0) (5,1)
[1]: (0,0)

Verifying formula 2 at query.q:5
 -- Formula is satisfied.
(246/316 runs) Pr(<> ...) in [0.728427,0.823015] (95% CI)
Values in [8.93272,306.729] mean=35.1171 steps=2.97796: 158 1589 0

Verifying formula 3 at query.q:8
 -- Formula is satisfied.
(50 runs) E(max) = 10.58 ± 0.14 (95% CI)

Verifying formula 4 at query.q:11
 -- Formula is satisfied.
(50 runs) E(min) = ≈ 100
Values in [100,100] mean=100 steps=1: 50

Verifying formula 5 at query.q:14
 -- Formula is satisfied.
(37 runs) H0: Pr(<> ...) >= 0.9
with confidence 0.95.
"""


def test_the_older_form_is_read_with_terminal_codes_and_the_level_on_a_line_of_its_own() -> None:
    first, second, third = parse_output(OLD).answers
    assert (first.kind, first.runs, first.mean, first.half_width, first.satisfied) == (
        "E(max)",
        10000,
        4.5129,
        None,
        True,
    )
    assert (second.kind, second.runs, second.low, second.high, second.level) == ("Pr", 29, 0.0, 0.0981446, 0.95)
    assert (third.kind, third.satisfied, third.place) == ("", False, "q.q:3")
    assert failure(parse_output(OLD), 3, 0) == ""


def test_steps_is_the_width_of_a_bin_and_no_confidence() -> None:
    first = parse_output(OLD).answers[0]
    assert first.histogram == ValueHistogram(3.0, 9.0, 4.5129, 1.0, (1360, 3809, 3472, 1090, 242, 24, 3))
    assert first.half_width is None


def test_the_newer_form_is_read_with_intervals_successes_and_values_without_spread() -> None:
    _, second, third, fourth, fifth = parse_output(NEW).answers
    assert (second.successes, second.runs, second.low, second.high, second.level) == (
        246,
        316,
        0.728427,
        0.823015,
        0.95,
    )
    assert (third.mean, third.half_width, third.level) == (10.58, 0.14, 0.95)
    assert (fourth.kind, fourth.mean, fourth.half_width) == ("E(min)", 100.0, None)
    assert (fifth.kind, fifth.runs, fifth.satisfied, fifth.level) == ("H", 37, True, 0.95)


def test_courses_are_read_one_line_a_run_with_lengths_and_times_of_their_own() -> None:
    courses = parse_output(NEW).answers[0].courses
    assert set(courses) == {"m_1.Temp", "p_1.next_i"}
    assert courses["m_1.Temp"][0].points == ((0.0, 18.2), (5.0, 18.9), (5.0, 19.25), (12.5, 10.0))
    assert [len(course.points) for course in courses["m_1.Temp"]] == [4, 2]
    assert [course.run for course in courses["p_1.next_i"]] == [0, 1]


def test_errors_keep_their_file_and_position() -> None:
    position = "./two_swing.xml:/nta/template[1]/location[2]/label[1]:3"
    stderr = f"{position}: [error] Unknown identifier: Boy0.\n[warning] Strict invariant.\n"
    output = parse_output("", stderr)
    assert output.errors == (stderr.splitlines()[0],)
    sentence = failure(output, 2, 1)
    assert "template[1]/location[2]" in sentence and "Boy0" in sentence


def test_a_missing_licence_is_told_with_the_remedy() -> None:
    output = parse_output("", "License key is not set.\nFailed to retrieve a lease.\n")
    assert "--lease" in failure(output, 1, 1) and "License key is not set" in failure(output, 1, 1)


def test_an_answer_that_is_missing_is_missed() -> None:
    cut = NEW[: NEW.index("Verifying formula 3")]
    assert failure(parse_output(cut), 5, 139) == "verifyta answered 2 of 5 queries and ended with code 139"
    begun = parse_output(cut + "Verifying formula 3 at query.q:8\n")
    assert "answered 2 of 5" in failure(begun, 5, 0)
    assert failure(parse_output(NEW), 5, 1) == "verifyta ended with code 1 after its last answer"


def test_garbage_is_said_to_be_garbage() -> None:
    output = parse_output("Bus error (core dumped)\n[0]: (0,1)\n", "")
    assert output.answers == ()
    assert "Bus error" in failure(output, 1, 1)


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=200), st.integers(0, 600))
def test_no_text_whatever_breaks_the_reader(noise: str, place: int) -> None:
    output = parse_output(NEW[:place] + noise + NEW[place:], noise)
    assert len(output.answers) <= 6 + noise.count("Verifying")
    failure(output, 5, 0)


@pytest.mark.parametrize("text", ["", "\n\n", "Options for the verification:\n  Generating no trace\n"])
def test_nothing_printed_is_no_answer(text: str) -> None:
    assert failure(parse_output(text), 1, 0) == "verifyta answered 0 of 1 queries and ended with code 0"
