"""From a model to its artefacts, which public tools and the thesis's readers find, and which read back whole."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

from sim.effects import effect_summary
from sim.files import ArtefactError
from sim.lab.formats.foreign.bundle import Artefacts
from sim.lab.formats.foreign.dot import INIT, Source, SourceLocation
from sim.lab.formats.foreign.flow_file import FlowFile, parse_equation
from sim.lab.formats.foreign.flow_kinds import equation_text, quote_name
from sim.lab.formats.foreign.histogram import Histogram
from sim.lab.formats.foreign.report import (
    EFFECT_PREFIX,
    EMPTY_WORD,
    UNOBSERVED_EVENT,
    Report,
    ReportedLaw,
    ReportedLocation,
    ReportRow,
    Table,
)
from sim.sha import FIXED_PARAMETER, SHA, Alphabet, Bins, Distribution, Edge, Location, Model, distributions

if TYPE_CHECKING:
    from sim.lab.learning.lsha import ObservationTable, TableRow

RawValues = Mapping[str, Sequence[float]]
"""The parameter values that the learner saw, by location."""

K = TypeVar("K")
Key = tuple[str, tuple[tuple[str, float], ...]]
"""A law's kind and parameters, by which equal laws are one."""


def to_artefacts(
    model: Model, values: RawValues | None = None, observations: ObservationTable | None = None
) -> Artefacts:
    """Source, report, histogram and flow file of a model; base name is the automaton's.

    `observations` is the observation table of a learner that has one. These formats have no place for effects: the
    report names them, a line `EFFECT_PREFIX` each, and only the model's JSON holds them. Equal equations share a
    number, equal laws a name `D_i` (and their raw values). Raises ArtefactError for names that the formats cannot hold.
    """
    sha = model.sha
    equations = _number_keys(equation_text(location.flow, model.temperature) for location in sha.locations)
    laws = _number_keys(_key(location.distribution) for location in sha.locations if location.distribution)
    source = _source(sha, equations, laws, model.temperature)
    effects = ((f"{EFFECT_PREFIX} {number}", effect_summary(each)) for number, each in enumerate(sha.effects, start=1))
    table = None
    if observations:
        # The cell of each location: its flow and its distribution by their numbers.
        cells = {
            node.name: f"(f_{node.flow},{f'{node.distribution})' if node.distribution else f'{EMPTY_WORD})'}"
            for node in source.locations
        }
        table = _table(observations, cells)
    report = Report(
        events=tuple(_events(model.alphabet)),
        distributions=reported_laws(sha),
        table=table,
        performance=(("SAMPLED TRACES", str(len(model.provenance.traces))), *effects),
        locations=tuple(_line(location) for location in sha.locations),
        limits={"low": float(sha.low), "high": float(sha.high), "max_rate": float(sha.max_rate)},
    )
    flows = FlowFile({number: parse_equation(text) for text, number in equations.items()})
    # One run of values: every law in order, with those of its locations.
    raw = values or {}
    unknown = sorted(set(raw) - {location.name for location in sha.locations})
    if unknown:
        raise ArtefactError(f"raw values are given for location {unknown[0]!r}, which the automaton does not have")
    run: dict[str, tuple[float, ...]] = {f"D_{number}": () for number in sorted(laws.values())}
    for location in sha.locations:
        if location.distribution is not None:
            run[f"D_{laws[_key(location.distribution)]}"] += tuple(map(float, raw.get(location.name, ())))
    return Artefacts(sha.name, source, report, Histogram((run,) if run else ()), flows)


def reported_laws(sha: SHA) -> tuple[ReportedLaw, ...]:
    """The laws of an automaton's locations as its report has them: equal ones once, `D_0` first."""
    laws = {_key(location.distribution): location.distribution for location in sha.locations if location.distribution}
    return tuple(ReportedLaw(f"D_{number}", float(distributions.mean(law))) for number, law in enumerate(laws.values()))


def _number_keys(keys: Iterator[K]) -> dict[K, int]:
    """Each different key with its number, in the order of appearance."""
    numbers: dict[K, int] = {}
    for key in keys:
        numbers.setdefault(key, len(numbers))
    return numbers


def _key(law: Distribution) -> Key:
    return law.kind, tuple(sorted(law.params.items()))


def _source(sha: SHA, equations: Mapping[str, int], laws: Mapping[Key, int], state: str) -> Source:
    """The automaton's own `__init__`, or one more node with an edge without event to the initial location."""
    names = {location.name for location in sha.locations}
    if INIT in names and sha.initial != INIT:
        raise ArtefactError(f"a location is called {INIT!r}, which marks the start in this format; rename it")
    nodes = [
        SourceLocation(
            _plain_name(location.name),
            equations[equation_text(location.flow, state)],
            f"D_{laws[_key(location.distribution)]}" if location.distribution else None,
        )
        for location in sha.locations
    ]
    edges = list(sha.edges)
    if INIT not in names:
        nodes.append(SourceLocation(INIT))
        edges.append(Edge(INIT, "", sha.initial))
    return Source(tuple(nodes), tuple(edges))


def _table(observations: ObservationTable, cells: Mapping[str, str]) -> Table:
    """Words with their symbols run together, as the public learner writes them."""

    def word(symbols: Sequence[str]) -> str:
        return "".join(map(_plain_name, symbols)) or EMPTY_WORD

    def rows(part: Sequence[TableRow]) -> tuple[ReportRow, ...]:
        return tuple(
            ReportRow(word(row.word), tuple(UNOBSERVED_EVENT if cell is None else cells[cell] for cell in row.cells))
            for row in part
        )

    return Table(tuple(map(word, observations.suffixes)), rows(observations.upper), rows(observations.lower))


def _plain_name(name: str) -> str:
    if not name or name != name.strip() or name[0] in "-|" or any(sign in name for sign in ":\n\r\\"):
        raise ArtefactError(
            f"{name!r} cannot name a location or an event in a report; use letters, digits, _ and blanks"
        )
    return name


def _line(location: Location) -> ReportedLocation:
    # The flow's constants in the thesis's spelling (`alpha` for a fixed linear drift), then the inputs.
    flow, values = location.flow, dict[str, float | str]()
    spelling = {FIXED_PARAMETER: "alpha"} if flow.kind == "linear" else {}
    constants = {spelling.get(name, name): float(value) for name, value in sorted(flow.params.items())}
    for driver in flow.inputs:
        constants[f"{quote_name(driver.signal)}.gain"] = float(driver.gain)
        constants[f"{quote_name(driver.signal)}.reference"] = float(driver.reference)
    calls = {"flow": (flow.kind, constants)}
    law = location.distribution
    if law is not None:
        values = {"mu": float(distributions.mean(law)), "sigma": float(distributions.variance(law)) ** 0.5}
        if law.kind == "normal":
            values = {name: float(law.params[name]) for name in ("mu", "sigma")}
        else:
            calls["law"] = (law.kind, {name: float(value) for name, value in sorted(law.params.items())})
    return ReportedLocation(location.name, values | {"entry": location.entry}, calls)


def _events(alphabet: Alphabet) -> Iterator[tuple[str, str]]:
    """The symbols with what they mean, in the words of the public reports."""
    for channel in alphabet.channels:
        if isinstance(channel, Bins):
            for index, symbol in enumerate(channel.symbols):
                low = f"{channel.thresholds[index - 1]:g}<=" if index else ""
                high = f"<{channel.thresholds[index]:g}" if index < len(channel.thresholds) else ""
                yield _plain_name(symbol), f"{low}{channel.signal}{high}"
        else:
            yield _plain_name(channel.rising), f"{channel.signal} 0->1"
            yield _plain_name(channel.falling), f"{channel.signal} 1->0"
