"""`<NAME>.txt`: the learner's report, in the public learner's sections and in the thesis's lines, parsed by a grammar.

Public learner: `--EVENT LABELS DICT--` (some versions), `--OBSERVABLE EVENTS--`, `--LEARNED DISTRIBUTIONS--` with
`D_0(1.000003)` (a mean) or `N_0(avg, var)`, `--FINAL OBSERVATION TABLE--`, `--PERFORMANCE DATA--`. Thesis:
`Location 2: mu=23.5, sigma=1.2, flow=linear(alpha=0.05)`, under `--LOCATIONS--` or without any header. What is written
has both, so that either reader finds what it needs; `Limits:` is this project's own line (degC, degC/s).
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from lark import Lark, Token, Tree

from sim.files import file_error, read_text
from sim.lab.formats.foreign.grammar import finite, parse_text, tokens, trees

GRAMMAR = r"""
start: _NL? (labels | events | laws | table | performance | locations | _line)*
labels: "--EVENT LABELS DICT--" _NL pair*
events: "--OBSERVABLE EVENTS--" _NL pair*
laws: "--LEARNED DISTRIBUTIONS--" _NL law*
table: "--FINAL OBSERVATION TABLE--" _NL (header SEPARATOR _NL upper SEPARATOR _NL lower (SEPARATOR _NL)?)?
performance: "--PERFORMANCE DATA--" _NL pair*
locations: "--LOCATIONS--" _NL
_line: location | limits

pair: KEY ":" TEXT? _NL
law: LAW "(" ATOM ("," ATOM)? ")" _NL
header: "|" WORD ("|" WORD)* _NL
upper: (ROW _NL)*
lower: (ROW _NL)*
location: LOCATION KEY ":" _items _NL
limits: LIMITS ":" _items _NL
_items: item ("," item)*
item: ATOM "=" ATOM arguments?
arguments: "(" _items? ")"

LOCATION.2: /Location(?=[ \t])/
LIMITS.2: /Limits(?=[ \t]*:)/
LAW: /[^\W\d]\w*(?=[ \t]*\()/
KEY: /[^\s:|\-][^:\n]*/
TEXT: /[^\s][^\n]*/
ATOM: /`[^`\n]+`[^\s,()=:|`]*|[^\s,()=:|`]+/
WORD: /[^|\s\-(](?:[^|\n]*[^|\s])?/
ROW: /[^|\s\-(][^|\n]*\|[^\n]*/
SEPARATOR: /-+(?:\+-+)+/
_NL: /(?:[ \t\r]*\n)+[ \t]*/
%ignore /[ \t\r]+/
"""
CELL = re.compile(r"\([^()|]*\)(?:;\([^()|]*\))*")
"""A cell of the observation table. Rows are one word to the grammar: a table of some hundred locations has a million
cells, and the parser would take minutes for what `split` does."""
EXPECTED_TEXT = (
    "a report has sections like --OBSERVABLE EVENTS--, --LEARNED DISTRIBUTIONS-- with lines D_0(1.5), "
    "--FINAL OBSERVATION TABLE--, --PERFORMANCE DATA--, or lines Location 2: mu=23.5, sigma=1.2, flow=linear(alpha=0.1)"
)
UNOBSERVED_EVENT = "(ε,ε)"
EMPTY_WORD = "ε"


EFFECT_PREFIX = "EFFECT"
"""How the lines begin, in the section of performance data, that name a model's effects: no other place holds them."""


@dataclass(frozen=True, slots=True)
class ReportedLaw:
    """A learned distribution: its mean and, for `N_i`, its variance, in the unit of the flow's parameter."""

    name: str
    mean: float
    variance: float | None = None


@dataclass(frozen=True, slots=True)
class ReportRow:
    """A word (its event symbols run together) with one cell per suffix, as written: `(f_1,D_3)`, unobserved `(ε,ε)`."""

    word: str
    cells: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Table:
    """The observation table: prefix-closed words above, their one-event extensions below, one column per suffix."""

    suffixes: tuple[str, ...]
    upper: tuple[ReportRow, ...]
    lower: tuple[ReportRow, ...] = ()


@dataclass(frozen=True, slots=True)
class ReportedLocation:
    """A line of the thesis: the law's mu and sigma (or another `law`), the flow with its constants, the entry mode.

    `values` has what the line says in plain `key=value` form, numbers as numbers; `calls` the bracketed ones, such as
    flow -> ("linear", {"alpha": 0.05}).
    """

    name: str
    values: Mapping[str, float | str]
    calls: Mapping[str, tuple[str, Mapping[str, float]]]


@dataclass(frozen=True, slots=True)
class Report:
    """Everything that a report says, each part in the file's order; `table` is None where the section is empty."""

    events: tuple[tuple[str, str], ...] = ()
    distributions: tuple[ReportedLaw, ...] = ()
    table: Table | None = None
    performance: tuple[tuple[str, str], ...] = ()
    labels: tuple[tuple[str, str], ...] = ()
    locations: tuple[ReportedLocation, ...] = ()
    limits: Mapping[str, float] = field(default_factory=dict)


@cache
def _parser() -> Lark:
    return Lark(GRAMMAR, parser="lalr", propagate_positions=True)


def read_report(path: Path) -> Report:
    """The learner's report. Raises ArtefactError with file and line."""
    return parse_report(read_text(path), path)


def parse_report(text: str, file: str | Path = "report") -> Report:
    """As `read_report`, from the text itself; `file` is the name for messages."""
    tree = parse_text(_parser(), text + "\n", file, EXPECTED_TEXT)
    if not tree.children:
        raise file_error(file, None, f"the report is empty; {EXPECTED_TEXT}")
    sections: dict[str, Tree[Token]] = {}
    for child in tree.children:
        if isinstance(child, Tree) and child.data in ("labels", "events", "laws", "table", "performance"):
            if child.data in sections:
                raise file_error(
                    file, child.meta.line, f"the section {child.data!r} stands here a second time; keep one"
                )
            sections[str(child.data)] = child
    laws = []
    for law in trees(sections.get("laws"), "law"):
        name, *numbers = (child for child in law.children if isinstance(child, Token))
        mean = finite(numbers[0], file, f"the mean of {name}")
        variance = finite(numbers[1], file, f"the variance of {name}") if len(numbers) > 1 else None
        if variance is not None and variance < 0:
            raise file_error(file, name.line, f"the variance of {name} is {variance}; it cannot be negative")
        laws.append((ReportedLaw(str(name), mean, variance), law.meta.line))
    locations = []
    for line in trees(tree, "location"):
        key = next(child for child in line.children if isinstance(child, Token) and child.type == "KEY")
        locations.append((ReportedLocation(str(key).strip(), *_items(line, file)), line.meta.line))
    for named in (laws, locations):
        seen: set[str] = set()
        for part, row in named:
            if part.name in seen:
                raise file_error(file, row, f"{part.name} stands here a second time; keep one of them")
            seen.add(part.name)
    limits = next((_items(line, file)[0] for line in trees(tree, "limits")), {})
    return Report(
        events=_pairs(sections.get("events")),
        distributions=tuple(law for law, _ in laws),
        table=_table(sections.get("table"), file),
        performance=_pairs(sections.get("performance")),
        labels=_pairs(sections.get("labels")),
        locations=tuple(location for location, _ in locations),
        limits={name: value for name, value in limits.items() if isinstance(value, float)},
    )


def _pairs(section: Tree[Token] | None) -> tuple[tuple[str, str], ...]:
    return tuple((words[0], words[1] if len(words) > 1 else "") for words in map(_tokens, trees(section, "pair")))


def _tokens(tree: Tree[Token]) -> list[str]:
    return [str(child).strip() for child in tree.children if isinstance(child, Token)]


def _table(tree: Tree[Token] | None, file: str | Path) -> Table | None:
    header = trees(tree, "header")
    if tree is None or not header:
        return None
    suffixes = tuple(_tokens(header[0]))
    parts: list[tuple[ReportRow, ...]] = []
    for part in (*trees(tree, "upper"), *trees(tree, "lower")):
        rows = []
        for row in tokens(part):
            word, *cells = (cell.strip() for cell in row.split("|"))
            if len(cells) != len(suffixes):
                reason = f"the row of {word} has {len(cells)} cells; the table has {len(suffixes)} columns"
                raise file_error(file, row.line, reason)
            wrong = next((cell for cell in cells if not CELL.fullmatch(cell)), None)
            if wrong is not None:
                raise file_error(
                    file, row.line, f"the row of {word} has the cell {wrong[:40]!r}; write one like (f_1,D_0)"
                )
            rows.append(ReportRow(word, tuple(cells)))
        parts.append(tuple(rows))
    return Table(suffixes, *parts)


def _items(
    tree: Tree[Token], file: str | Path
) -> tuple[dict[str, float | str], dict[str, tuple[str, Mapping[str, float]]]]:
    """The plain and the bracketed items of a line; `entry`, `flow` and `law` are words, the rest is numbers."""
    values: dict[str, float | str] = {}
    calls: dict[str, tuple[str, Mapping[str, float]]] = {}
    for item in trees(tree, "item"):
        key, value = (child for child in item.children if isinstance(child, Token))
        arguments = trees(item, "arguments")
        if key in values or key in calls:
            raise file_error(file, key.line, f"{key} is given twice on this line; keep one of them")
        if arguments or key in ("flow", "law"):
            inner = _items(arguments[0], file)[0] if arguments else {}
            calls[str(key)] = (
                str(value),
                {name: number for name, number in inner.items() if isinstance(number, float)},
            )
        elif key == "entry":
            values[str(key)] = str(value)
        else:
            # Only `max_rate` may be `inf`, which says that there is no limit.
            unlimited = key == "max_rate" and value == "inf"
            values[str(key)] = float("inf") if unlimited else finite(value, file, str(key))
    return values, calls


def report_text(report: Report) -> str:
    """The report in both forms; for what the public learner wrote, byte for byte the same text."""
    parts = []
    if report.labels:
        parts += ["--EVENT LABELS DICT--\n\n", *_pair_lines(report.labels)]
    parts += ["\n\n--OBSERVABLE EVENTS--\n\n", *_pair_lines(report.events)]
    parts += [
        "\n\n--LEARNED DISTRIBUTIONS--\n\n",
    ]
    for law in report.distributions:
        numbers = ", ".join(decimal(value) for value in (law.mean, law.variance) if value is not None)
        parts.append(f"{law.name}({numbers})\n")
    parts += ["\n\n--FINAL OBSERVATION TABLE--\n\n", *_table_lines(report.table), "\n"]
    parts += ["\n\n--PERFORMANCE DATA--\n\n", *(f"{key}:\t{text}\n" for key, text in report.performance)]
    if report.locations or report.limits:
        parts.append("\n\n--LOCATIONS--\n\n")
    if report.limits:
        parts.append(f"Limits: {', '.join(f'{key}={_plain(value)}' for key, value in report.limits.items())}\n")
    for location in report.locations:
        items = [f"{key}={_plain(value)}" for key, value in location.values.items()]
        for key, (kind, constants) in location.calls.items():
            written = ", ".join(f"{name}={_plain(value)}" for name, value in constants.items())
            items.append(f"{key}={kind}({written})")
        parts.append(f"Location {location.name}: {', '.join(items)}\n")
    return "".join(parts)


def _pair_lines(pairs: tuple[tuple[str, str], ...]) -> Iterator[str]:
    return (f"{key}: {text}\n" for key, text in pairs)


def decimal(value: float) -> str:
    """Six decimals, as the public learner prints, where they say it all; else the shortest exact text."""
    text = f"{value:.6f}"
    return text if float(text) == value else repr(float(value))


def _table_lines(table: Table | None) -> Iterator[str]:
    """Columns as wide as their widest cell, words as wide as the longest."""
    if table is None:
        return
    rows = (*table.upper, *table.lower)
    width = max((len(row.word) for row in rows), default=0)
    widths = [max((len(row.cells[i]) for row in rows), default=0) for i in range(len(table.suffixes))]
    separator = "-" * max(width, 1) + "".join("+" + "-" * max(size, 1) for size in widths) + "\n"
    yield _table_line("", table.suffixes, width, widths)
    yield separator
    for part in (table.upper, table.lower):
        for row in part:
            yield _table_line(row.word, row.cells, width, widths)
        yield separator


def _table_line(word: str, cells: tuple[str, ...], width: int, widths: list[int]) -> str:
    padded = (cell.ljust(size) for cell, size in zip(cells, widths, strict=True))
    return "|".join([word.ljust(width), *padded]) + "\n"


def _plain(value: float | str) -> str:
    return value if isinstance(value, str) else repr(float(value))
