"""What verifyta prints, as records: verdicts, estimates, histograms, simulated courses, errors.

The forms of 4.1.20 to 5.0 are read: progress lines and terminal codes are dropped, an estimate's interval comes on its
own line or on the next, and a value without spread is printed as `≈ 100`.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace

_CODES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\r")
_FLOAT = r"[-+]?(?:\d+\.?\d*(?:[eE][-+]?\d+)?|inf|nan)"
_FORMULA = re.compile(r"Verifying (?:formula|property) (\d+) at (.+)")
_VERDICT = re.compile(r"-- (?:Formula|Property) (is satisfied|is NOT satisfied|MAY be satisfied|MAY NOT be satisfied)")
_ESTIMATE = re.compile(r"\((?:(\d+)/)?(\d+) runs\)\s*(.*)")
_INTERVAL = re.compile(rf"(Pr\(.*\)) in \[({_FLOAT}),\s*({_FLOAT})\](?:\s*\(([\d.]+)% CI\))?")
_MEAN = re.compile(rf"E\((\w+)\) = (?:≈\s*|~\s*)?({_FLOAT})(?:\s*(?:±|\+/-)\s*({_FLOAT}))?(?:\s*\(([\d.]+)% CI\))?")
_HYPOTHESIS = re.compile(r"(H[01]: .*|Pr\(.*\) [<>]= .*)")
_CONFIDENCE = re.compile(r"with confidence ([\d.]+?)\.?$")
_HISTOGRAM = re.compile(rf"Values in \[({_FLOAT}),\s*({_FLOAT})\] mean=({_FLOAT}) steps=({_FLOAT}):(.*)")
_COURSE = re.compile(r"\[(\d+)\]:(.*)")
_POINT = re.compile(rf"\(({_FLOAT}),\s*({_FLOAT})\)")
_ERROR = re.compile(r"(?:^|:\s*)\[error\]|^(?:Error|syntax error|Out of memory|Internal error)\b", re.IGNORECASE)
_LICENCE = re.compile(r"licen[cs]e|\blease\b", re.IGNORECASE)
_REMARK = re.compile(r"^(?:--|Options for|Generating|Search order|Using|Seed is|State space|\[warning\]|Showing)")


@dataclass(frozen=True, slots=True)
class ValueHistogram:
    """The values of an estimate in bins from `low` to `high`. `width` is the width of a bin, no confidence interval."""

    low: float
    high: float
    mean: float
    width: float
    counts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class PrintedCourse:
    """One simulated run of one expression: (time, value) points, joined by straight lines."""

    run: int
    points: tuple[tuple[float, float], ...]


@dataclass(frozen=True, slots=True)
class VerifytaAnswer:
    """What the engine said of one formula.

    `satisfied` is None where it said neither; `kind` is "Pr", "E(max)", "E(min)", "H" (a hypothesis), "simulate" or ""
    (symbolic). `mean` with `half_width` is an expectation's, `low` and `high` a probability's interval, at `level`.
    `courses` gives the runs of each expression; their lengths differ.
    """

    number: int
    place: str
    satisfied: bool | None = None
    kind: str = ""
    runs: int | None = None
    successes: int | None = None
    mean: float | None = None
    half_width: float | None = None
    low: float | None = None
    high: float | None = None
    level: float | None = None
    statement: str = ""
    histogram: ValueHistogram | None = None
    courses: dict[str, tuple[PrintedCourse, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Output:
    """All that was printed: answers in order, error lines (with their file positions), lines that were not read."""

    answers: tuple[VerifytaAnswer, ...]
    errors: tuple[str, ...] = ()
    licence: str = ""
    unread: tuple[str, ...] = ()


def parse_output(stdout: str, stderr: str = "") -> Output:
    """Reads what verifyta printed. Nothing is raised for text that it never prints: such lines are in `unread`."""
    answers: list[VerifytaAnswer] = []
    errors: list[str] = []
    unread: list[str] = []
    licence = expression = ""
    for line in (*_lines(stdout), *_lines(stderr)):
        # Errors before results: an error may quote a line that looks like one.
        if match := _FORMULA.search(line):
            answers.append(VerifytaAnswer(int(match[1]), match[2].strip()))
            expression = ""
        elif _ERROR.search(line):
            errors.append(line)
        elif answers and expression and (match := _COURSE.match(line)):
            # The courses of one expression follow one another, a line a run, under the line that names it.
            points = tuple((float(time), float(value)) for time, value in _POINT.findall(match[2]))
            courses = dict(answers[-1].courses)
            courses[expression] = (*courses.get(expression, ()), PrintedCourse(int(match[1]), points))
            runs = max(answers[-1].runs or 0, len(courses[expression]))
            answers[-1] = replace(answers[-1], kind="simulate", runs=runs, courses=courses)
        elif answers and (
            hit := next(((read, match) for pattern, read in READERS if (match := pattern.match(line))), None)
        ):
            read, match = hit
            answers[-1] = read(answers[-1], match)
        elif answers and line.endswith(":") and not _REMARK.match(line):
            expression = line[:-1]
        elif _LICENCE.search(line):
            licence = licence or line
        elif not _REMARK.match(line):
            unread.append(line)
    return Output(tuple(answers), tuple(errors), licence, tuple(unread))


def _lines(text: str) -> Iterator[str]:
    for line in text.split("\n"):
        bare = _CODES.sub("", line).strip()
        if bare:
            yield bare


def _verdict(answer: VerifytaAnswer, match: re.Match[str]) -> VerifytaAnswer:
    return replace(answer, satisfied={"is satisfied": True, "is NOT satisfied": False}.get(match[1]))


def _estimate(answer: VerifytaAnswer, match: re.Match[str]) -> VerifytaAnswer:
    counted = replace(answer, successes=None if match[1] is None else int(match[1]), runs=int(match[2]))
    rest = match[3]
    if interval := _INTERVAL.match(rest):
        level = None if interval[4] is None else float(interval[4]) / 100
        low, high = float(interval[2]), float(interval[3])
        return replace(counted, kind="Pr", statement=interval[1], low=low, high=high, level=level)
    if mean := _MEAN.match(rest):
        half = None if mean[3] is None else float(mean[3])
        level = None if mean[4] is None else float(mean[4]) / 100
        return replace(counted, kind=f"E({mean[1]})", mean=float(mean[2]), half_width=half, level=level)
    if _HYPOTHESIS.match(rest):
        return replace(counted, kind="H", statement=rest)
    return replace(counted, statement=rest)


def _confidence(answer: VerifytaAnswer, match: re.Match[str]) -> VerifytaAnswer:
    return replace(answer, level=float(match[1]))


def _histogram(answer: VerifytaAnswer, match: re.Match[str]) -> VerifytaAnswer:
    counts = tuple(int(part) for part in match[5].split() if part.isdecimal())
    low, high, mean, width = (float(match[group]) for group in range(1, 5))
    return replace(answer, histogram=ValueHistogram(low, high, mean, width, counts))


READERS: tuple[tuple[re.Pattern[str], Callable[[VerifytaAnswer, re.Match[str]], VerifytaAnswer]], ...] = (
    (_VERDICT, _verdict),
    (_ESTIMATE, _estimate),
    (_CONFIDENCE, _confidence),
    (_HISTOGRAM, _histogram),
)


def failure(output: Output, wanted: int, code: int) -> str:
    """Why an output is no full answer to `wanted` formulas, in one sentence; empty when it is."""
    if output.errors:
        return f"verifyta refuses the model or a query: {_first_lines(output.errors)}"
    if output.licence and len(output.answers) < wanted:
        return f"verifyta has no valid licence ({output.licence}); set one with verifyta --lease HOURS --key KEY"
    decided = [answer for answer in output.answers if answer.satisfied is not None or answer.kind]
    if len(decided) < wanted:
        printed = f"; it printed {_first_lines(output.unread)}" if output.unread else ""
        return f"verifyta answered {len(decided)} of {wanted} queries and ended with code {code}{printed}"
    return f"verifyta ended with code {code} after its last answer" if code else ""


def _first_lines(lines: Iterable[str]) -> str:
    """The first lines of several, cut to what fits a sentence."""
    several = list(lines)
    more = f" (and {len(several) - 3} more lines)" if len(several) > 3 else ""
    return "; ".join(line[:200] for line in several[:3]) + more
