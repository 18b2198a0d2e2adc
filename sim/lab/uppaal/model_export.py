"""A model and a trace as UPPAAL documents: the main one with flows and noise, the minimal one of compatibility."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, isfinite
from pathlib import Path

import numpy as np

from drivers.errors import OneLineError
from sim.effects import check_sha, in_sensor_scale
from sim.engine import Policy, Start, open_loop
from sim.files import replace_durably, write_error
from sim.lab.uppaal.document import ExportedQuery, System, comment_text, number, xml_text
from sim.lab.uppaal.effects import effect_texts
from sim.lab.uppaal.effects import export_refusal as refused_effects
from sim.lab.uppaal.layout import in_a_row, on_a_circle
from sim.lab.uppaal.machine import Beginning, Move, machine, variables
from sim.lab.uppaal.players import event_arrays, input_declarations, input_player, player, structure
from sim.lab.uppaal.queries import compatibility, default_questions, export_questions, query_file
from sim.lab.uppaal.replay import ReplayedTrace, build_replay, replayed_signals
from sim.lab.uppaal.rules import check_rules
from sim.lab.uppaal.words import FreshNames, spell_names
from sim.sha import SHA, UNKNOWN, Model, Trace, alphabet_symbols, distributions, transitions

MAX_TICK_S = 1
"""Seconds between two draws of the noise, at most: also between them the temperature may cross a limit."""
MAX_NAME_CHARS = 80
"""Letters of a model's and of a trace's name in the name of a file."""


@dataclass(frozen=True, slots=True)
class Document:
    """One exported file: base name, XML text, its queries, and sentences about what the reader should know."""

    name: str
    xml: str
    questions: tuple[ExportedQuery, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Exported:
    """Both documents of one trace, and what they replay."""

    main: Document
    minimal: Document
    replay: ReplayedTrace = field(repr=False)


class ExportError(OneLineError, ValueError):
    """A model cannot be exported, or its text breaks a rule of UPPAAL's parser."""


def export(
    model: Model,
    trace: Trace,
    *,
    policy: Policy = "resync",
    start: Start = "measured",
    tick: int = MAX_TICK_S,
    formulas: Sequence[str] = (),
    xml_template: str = "",
) -> Exported:
    """The main and the minimal document of `model` replaying `trace`.

    `policy` is what an event without an edge does in the main model (the minimal one stops there, that is its
    question); `tick` (s) bounds the time between two draws of the noise, 0 draws it at events only; `formulas` are
    queries (docs/checking.md) besides the default set; `xml_template` is as in `xml_text`. Raises ExportError, saying
    what is wrong, for a model with guards or several targets for one event, an input or temperature that the trace
    does not have, a query that UPPAAL would refuse, and a template that cannot be used or whose document it would.
    """
    if tick < 0:
        raise ExportError(f"the noise's tick must be at least 0 s, got {tick}")
    try:
        model = in_sensor_scale(model)
        check_sha(model.sha)
        replay = build_replay(model, trace, policy, start)
        declined = refused_effects(model.sha, tick, replay.passed_over)
        if declined:
            raise ExportError(f"model {model.sha.name!r} cannot be exported along trace {trace.name!r}: {declined}")
        more, skeletal = export_questions(formulas, model)
        peak = float(np.max(open_loop(model, trace, policy, start).mean))
        main = _main(model, replay, tick, (*default_questions(replay, float(ceil(peak))), *more), xml_template)
        minimal = _minimal(model, replay, (compatibility(), *skeletal), xml_template)
    except ExportError:
        raise
    except ValueError as error:
        raise ExportError(f"model {model.sha.name!r} cannot be exported along trace {trace.name!r}: {error}") from None
    for document in (main, minimal):
        broken = check_rules(document.xml, [question.formula for question in document.questions])
        if broken:
            raise ExportError(f"{document.name}: {'; '.join(broken)}")
    return Exported(main, minimal, replay)


def write(directory: Path, exported: Exported) -> list[Path]:
    """Writes `NAME.xml`, `NAME.q`, `NAME_val.xml`, `NAME_val.q`; returns the paths. Raises ArtefactError."""
    written = []
    for document in (exported.main, exported.minimal):
        texts = {f"{document.name}.xml": document.xml, f"{document.name}.q": query_file(document.questions)}
        for name, text in texts.items():
            try:
                directory.mkdir(parents=True, exist_ok=True)
                replace_durably(directory / name, text)
            except OSError as error:
                raise write_error(directory / name, error) from None
            written.append(directory / name)
    return written


def base_name(model: str, trace: str) -> str:
    """The base name of an export's files: letters, digits and underscores, MAX_NAME_CHARS of each name."""
    return "_".join(
        "".join(sign if sign.isalnum() and sign.isascii() else "_" for sign in part).strip("_")[:MAX_NAME_CHARS] or "x"
        for part in (model, trace)
    )


def _main(
    model: Model, replay: ReplayedTrace, tick: int, questions: tuple[ExportedQuery, ...], xml_template: str
) -> Document:
    sha = model.sha
    names = FreshNames(location.name for location in sha.locations)
    known = variables(names, replayed_signals(sha))
    channels = _channels(model, replay.symbols, names)
    moves = [*_edges(sha, channels), *((source, channels[symbol], target) for source, symbol, target in replay.added)]
    law = replay.x0
    drawn = distributions.variance(law) > 0
    begin = Beginning(replay.location, replay.age, distributions.mean(law), law if drawn else None)
    more = effect_texts(
        sha, names, known.inputs, own=(known.jump, known.since), channels=channels, clocks=replay.clocks
    )
    constants, template = machine(sha, names, known, moves=moves, begin=begin, tick=tick, more=more)
    # Broadcast channels: statistical model checking takes no others, and an event without an edge passes as here.
    ids = {symbol: index for index, symbol in enumerate(channels)}
    feeder = input_player(replay.readings, known.inputs)
    templates = [on_a_circle(template), in_a_row(player(channels, ids, replay.symbols, timed=True))]
    templates += [in_a_row(feeder)] if feeder else []
    instances = [("m_1", "Machine"), ("p_1", "Player"), *([("i_1", "Inputs")] if feeder else [])]
    title = f"{comment_text(sha.name)} along {comment_text(replay.trace)}"
    lines = [
        f"// {title}. Temperatures in degC, times in seconds since the start.",
        f"const double {known.low} = {number(sha.low)};",
        f"const double {known.high} = {number(sha.high)};",
    ]
    if isfinite(sha.max_rate):
        lines.append(f"const double {known.max_rate} = {number(sha.max_rate)};")
    if tick:
        lines += [
            "// The noise is drawn at each event, and after so many seconds without one.",
            f"const int {known.tick} = {tick};",
        ]
    lines += [_chan("broadcast chan", channels, ids), event_arrays(replay.symbols, replay.times, ids)]
    if known.inputs:
        lines.append(input_declarations(replay.readings, known.inputs))
    declared = "\n".join([*lines, constants])
    name = base_name(sha.name, replay.trace)
    system = System(
        comment_text(f"{sha.name} along {replay.trace}"), declared, tuple(templates), tuple(instances), questions
    )
    notes = []
    own = [move for move in replay.added if move[1] != UNKNOWN]
    if own:
        shown = ", ".join(f"{source} -{symbol}-> {target}" for source, symbol, target in own[:5])
        notes.append(f"{len(own)} moves that the automaton has no edge for were added by the policy: {shown}")
    if replay.dropped:
        notes.append(f"{replay.dropped} events without an edge are lost on broadcast channels, as the policy has it")
    if isfinite(sha.max_rate):
        notes.append("under a rate limit the noise at events is that of the unlimited flow, as in this program")
    return Document(name, xml_text(system, xml_template), questions, tuple(notes))


def _minimal(model: Model, replay: ReplayedTrace, questions: tuple[ExportedQuery, ...], xml_template: str) -> Document:
    """Binary channels: over broadcast ones an event that no edge takes would be lost, and the question vacuous."""
    sha = model.sha
    names = FreshNames(location.name for location in sha.locations)
    channels = _channels(model, replay.all_symbols, names)
    ids = {symbol: index for index, symbol in enumerate(channels)}
    moves = _edges(sha, channels)
    if UNKNOWN in replay.all_symbols:
        moves += [(location.name, channels[UNKNOWN], sha.initial) for location in sha.locations]
    templates = (
        on_a_circle(structure([location.name for location in sha.locations], names, moves, sha.initial)),
        in_a_row(player(channels, ids, replay.all_symbols, timed=False)),
    )
    title = f"{comment_text(sha.name)} along {comment_text(replay.trace)}: does it accept every event?"
    declared = "\n".join([f"// {title}", _chan("chan", channels, ids), event_arrays(replay.all_symbols, None, ids)])
    system = System(title, declared, templates, (("m_1", "Machine"), ("p_1", "Player")), questions)
    return Document(f"{base_name(sha.name, replay.trace)}_val", xml_text(system, xml_template), questions)


def _edges(sha: SHA, channels: Mapping[str, str]) -> list[Move]:
    """The automaton's edges. One on UNKNOWN is left out: that event always leads to the initial location."""
    moves = transitions(sha)
    return [(source, channels[symbol], target) for (source, symbol), target in moves.items() if symbol != UNKNOWN]


def _channels(model: Model, played: Iterable[str], names: FreshNames) -> dict[str, str]:
    """symbol -> channel, in the alphabet's order, then the edges', then the trace's."""
    edges = [edge.symbol for edge in model.sha.edges]
    symbols = list(dict.fromkeys([*alphabet_symbols(model.alphabet), *edges, *played]))
    own = dict(model.alphabet.uppaal)
    words = spell_names([own.get(symbol, symbol) for symbol in symbols])
    return {symbol: names.fresh(words[own.get(symbol, symbol)]) for symbol in symbols}


def _chan(kind: str, channels: Mapping[str, str], ids: Mapping[str, int]) -> str:
    """The channels' declarations, one a line, with the symbol and the number that EVENTS uses."""
    return "\n".join(
        f"{kind} {channel};  // {ids[symbol]}: {comment_text(symbol)}" for symbol, channel in channels.items()
    )
