"""`decanter model learn`: a model from traces, written with all its artefacts."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gateway.console import (
    CommandResult,
    Part,
    Progress,
    Rows,
    conclude,
    progress,
)
from gateway.entry import sentences
from gateway.lab.learning.familiar import familiarity_files, trained_familiarity
from gateway.lab.models.show import show_model, show_verdict, spread_sentence, summary
from gateway.lab.traces.load import channel_warnings, load_with_report
from sim.artefacts import VERDICT_FILE, ModelVerdict
from sim.lab.formats import check_free, write_model_directory
from sim.lab.learning import LearningError, check_data, find_drivers, machine_corrections
from sim.lab.learning.lsha import LshaSettings
from sim.lab.recordings import with_levels
from sim.sha import Bins, Model, Trace, display_unit, encode, encode_trace
from sim.strict_json import json_text

if TYPE_CHECKING:
    from sim.lab.learning import Coverage, DriverEvidence, MachineSpread
    from sim.lab.learning.bins import Learned
    from sim.lab.learning.lsha import LearnedLsha, ObservationTable, TraceAcceptance
    from sim.lab.recordings import ColumnMap

REPORT = "learning_report"
MAX_ROWS = 40
"""Rows of a table for a person; an automaton of hundreds of locations has tables that nobody reads."""

MAX_DRIVER_CANDIDATES = 16
"""Signals beside the alphabet's of which it is told whether they drive the temperature."""


def learn(
    method: str,
    paths: Sequence[str],
    map_name: str,
    out: Path,
    name: str,
    temperatures: Sequence[str],
    drivers: Sequence[str],
    seed: int,
    as_json: bool,
    observed_edges: bool,
    **options: float | str | None,
) -> None:
    """Carry out `decanter model learn`; its options and its help are in learning/commands.py."""
    settings: dict[str, Any] = {key: value for key, value in options.items() if value is not None}
    settings |= {"complete": False} if observed_edges else {}
    with sentences(), progress(f"learning ({method})") as report:
        if settings and method != "lsha":
            first = next(iter(settings))
            option = {"complete": "observed-edges"}.get(first, first.replace("_", "-"))
            raise ValueError(f"--{option} belongs to --method lsha; leave it out, or choose that method")
        # Each of several temperatures has its model in a folder of its name.
        several = len(set(temperatures)) > 1
        folders = {each: out / each.replace("/", "_") for each in temperatures} if several else {}
        for folder in folders.values() or (out,):
            check_free(folder, name)  # nobody waits for a model that cannot be written
        traces, column_map, read = load_with_report(paths, map_name)
        warnings = channel_warnings(traces, column_map.alphabet)
        wanted = list(dict.fromkeys(temperatures)) or [column_map.temperature]
        for temperature in wanted:
            check_data(traces, temperature)  # before one of several is learned in vain
        taught: dict[Path, TaughtModel] = {}
        for number, temperature in enumerate(wanted):
            part = partial(_report_part, report, number, len(wanted), temperature)
            lshas = LshaSettings(**settings) if method == "lsha" else None
            taught[folders.get(temperature, out)] = teach_model(
                traces,
                column_map,
                temperature=temperature,
                drivers=drivers,
                name=name,
                seed=seed,
                lsha=lshas,
                report=part,
            )
        written = {folder: each.write(folder) for folder, each in taught.items()}
    documents: list[dict[str, Any]] = [
        {
            "model": str(folder),
            "file": str(written[folder]),
            **summary(each.model),
            "diagnostics": each.shown,
            "verdict": each.verdict.as_command_json(),
            "familiar_cycles": each.cycles,
            "machines": asdict(each.spread),
            "drivers": [{**asdict(one), "sentence": one.sentence} for one in each.drivers],
            "left out": list(each.left_out),
            "not looked at": list(each.not_looked_at),
            "warnings": warnings,
        }
        for folder, each in taught.items()
    ]

    data = documents[0] if len(documents) == 1 else {"models": documents}
    data |= {"account": read.account()}

    def show() -> Iterator[Part]:
        yield read.account()
        for folder, each in taught.items():
            yield from map(_shortened, _model_parts(each, folder))
        several = len(taught) > 1
        for folder, each in taught.items():
            if each.verdict.word != "unfit":
                setting = shlex.quote(f"{_model_key(each.model, several)}={folder}")
                yield f"next, in the plant's folder: `decanter plc bind --keep {setting}`"

    conclude(CommandResult(data), lambda _: show(), as_json=as_json)


def _shortened(part: Part) -> Part:
    """The part; a table of more than MAX_ROWS rows without those beyond, which its title says."""
    if not isinstance(part, Rows) or len(part.rows) <= MAX_ROWS:
        return part
    title = f"{part.title} (the first {MAX_ROWS} of {len(part.rows)} rows; --json has all)"
    return replace(part, title=title, rows=part.rows[:MAX_ROWS])


def _report_part(report: Progress, number: int, count: int, temperature: str, what: str, share: float) -> None:
    report(f"{temperature}: {what}" if count > 1 else what, (number + share) / count)


def _model_key(model: Model, several: bool) -> str:
    """What a plant file calls the model of a temperature, of `several` or of the only one."""
    return f"temperature.{model.temperature}.model" if several else "model.path"


def _model_parts(taught: TaughtModel, out: Path) -> Iterator[Part]:
    yield from show_model(taught.model)
    for title, rows in taught.shown.items():
        if rows:
            yield Rows(title, list(rows[0]), [list(row.values()) for row in rows])
    for one in taught.drivers:
        yield one.sentence
    for signal in taught.left_out:
        yield f"left out of the alphabet: {signal}, which follows"
    yield from taught.not_looked_at
    yield spread_sentence(taught.spread, display_unit(taught.model.unit))
    cycles = taught.cycles
    yield f"familiarity: {f'{cycles} cycles' if cycles else 'unknown, too few cycles with an hour before them'}"
    yield f"model directory: {out}"
    yield from show_verdict(taught.verdict)
    if taught.acceptance is not None:
        counts = f"{taught.acceptance.accepted} of {taught.acceptance.traces} training traces"
        yield f"accepted: {counts}, by the observed edges alone"
        yield f"learning report: {out / (REPORT + '.md')}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TaughtModel:
    """A learned `model` and how it came about: tables `shown`, the machines' `spread`, how many `cycles` are familiar.

    `drivers` is what the traces say of each signal; channels of those in `left_out` are not in the model's alphabet.
    `not_looked_at` are sentences about signals of which it is not known whether they drive the temperature.
    `values`, `observations` and `more` files stand beside it in a model directory; `acceptance` is of `lsha` alone;
    `verdict` says where the model may be used.
    """

    model: Model
    drivers: tuple[DriverEvidence, ...]
    left_out: tuple[str, ...]
    not_looked_at: tuple[str, ...]
    shown: Mapping[str, Sequence[Mapping[str, Any]]]
    spread: MachineSpread
    cycles: int
    values: Mapping[str, tuple[float, ...]]
    observations: ObservationTable | None
    more: Mapping[str, str]
    acceptance: TraceAcceptance | None
    verdict: ModelVerdict

    def write(self, out: Path) -> Path:
        """Write the model directory; the path of its model.json. Raises ArtefactError where it cannot be written."""
        return write_model_directory(out, self.model, self.values, observations=self.observations, more=self.more)


def teach_model(
    traces: Sequence[Trace],
    column_map: ColumnMap,
    *,
    temperature: str,
    drivers: Sequence[str] = (),
    name: str,
    seed: int,
    lsha: LshaSettings | None,
    report: Progress,
) -> TaughtModel:
    """A model of the traces' signal `temperature` by the map's alphabet: L*_SHA with settings, else method `bins`.

    `drivers` are level signals in place of the alphabet's. Raises LearningError, in one sentence, where the traces
    cannot teach one.
    """
    # The judge brings rooms that a command begins without.
    from sim.lab.judge import judge_learning

    column_map, traces, evidence, left_out, not_looked_at = _choose_drivers(traces, column_map, temperature, drivers)
    observations, acceptance, more = None, None, dict[str, str]()
    if lsha is not None:
        from sim.lab.learning.lsha import learn_lsha, report_document, report_text

        words_learned = learn_lsha(
            traces, column_map.alphabet, temperature, name=name, seed=seed, settings=lsha, progress=report
        )
        account = words_learned.report
        more = {
            f"{REPORT}.json": json_text(report_document(account), indent=1) + "\n",
            f"{REPORT}.md": report_text(account, name),
        }
        model, spread, values = words_learned.model, words_learned.spread, words_learned.values
        observations, acceptance, shown = account.table, account.acceptance, lsha_diagnostics(words_learned)
        coverage = account.coverage
    else:
        learned = learn_traces(traces, column_map, name=name, seed=seed, report=report, temperature=temperature)
        model, spread, values, shown = learned.model, learned.spread, learned.values, diagnostics(learned)
        coverage = learned.coverage
    # Of several machines it is a model of their type, and has what is each one's own.
    model = replace(model, machines=machine_corrections(model, traces, spread), roles=column_map.roles)
    familiar = trained_familiarity(model, traces)
    verdict = judge_learning(model, [encode_trace(trace, model.alphabet) for trace in traces], coverage)
    return TaughtModel(
        model=model,
        drivers=evidence,
        left_out=left_out,
        not_looked_at=not_looked_at,
        shown=shown,
        spread=spread,
        cycles=0 if familiar is None else familiar.reference.held_out.size,
        values=values,
        observations=observations,
        more=more | familiarity_files(familiar) | {VERDICT_FILE: verdict.text()},
        acceptance=acceptance,
        verdict=verdict,
    )


def _choose_drivers(
    traces: Sequence[Trace], column_map: ColumnMap, temperature: str, drivers: Sequence[str]
) -> tuple[ColumnMap, Sequence[Trace], tuple[DriverEvidence, ...], tuple[str, ...], tuple[str, ...]]:
    """The map and traces by the alphabet that drives the temperature, the evidence, and which signals are left out.

    At the end sentences about those that were not looked at.

    Raises LearningError for a driver that no trace has.
    """
    alphabet = column_map.alphabet
    known = sorted({name for trace in traces for name in trace.signals})
    for name in drivers:
        if name not in known or name == temperature:
            raise LearningError(f"{name!r} cannot drive {temperature!r}; the signals are {', '.join(known)}")
    if drivers:
        alphabet = with_levels(alphabet, list(dict.fromkeys(drivers)), traces)
    levels = [channel.signal for channel in alphabet.channels if isinstance(channel, Bins)]
    switches = [channel.signal for channel in alphabet.channels if not isinstance(channel, Bins)]
    shared = [name for name in known if all(name in trace.signals for trace in traces)]
    others = [name for name in shared if name not in (temperature, *levels, *switches)]
    absent = [name for name in known if name not in (*shared, temperature, *switches)]
    reasons = {
        "not every trace has it": absent,
        f"no more than {MAX_DRIVER_CANDIDATES} beside the alphabet's are": others[MAX_DRIVER_CANDIDATES:],
    }
    not_looked_at = tuple(f"not looked at: {', '.join(names)}: {why}" for why, names in reasons.items() if names)
    evidence = find_drivers(
        traces,
        temperature,
        [*(name for name in levels if name in shared), *others[:MAX_DRIVER_CANDIDATES]],
        gap=alphabet.gap,
    )
    follow = {one.signal for one in evidence if one.verdict == "follows"} & set(levels) - set(drivers)
    # A single one is what whoever wrote the map means: it is only said.
    left_out = tuple(name for name in levels if name in follow) if len(set(levels) - follow) else ()
    if left_out:
        alphabet = replace(
            alphabet, channels=tuple(channel for channel in alphabet.channels if channel.signal not in left_out)
        )
    if alphabet is not column_map.alphabet:
        column_map = column_map.model_copy(update={"alphabet": alphabet})
        traces = [replace(trace, events=encode(trace, alphabet)) for trace in traces]
    return column_map, traces, evidence, left_out, not_looked_at


def learn_traces(
    traces: Sequence[Trace],
    column_map: ColumnMap,
    *,
    name: str,
    seed: int,
    report: Any = None,
    temperature: str | None = None,
    bands: bool = True,
) -> Learned:
    """A model of the traces by the map's alphabet, of its temperature or the one given, with its `bands` or without."""
    from sim.lab.learning.bins import learn_bins

    return learn_bins(
        traces,
        column_map.alphabet,
        temperature or column_map.temperature,
        name=name,
        seed=seed,
        bands=bands,
        progress=report,
    )


def write(out: Path, learned: Learned, more: Mapping[str, str] | None = None) -> Path:
    """Write the model directory with `more` files by their names; returns the path of its model.json."""
    return write_model_directory(out, learned.model, learned.values, more=more)


def coverage_rows(coverage: Sequence[Coverage]) -> list[dict[str, Any]]:
    """A row a horizon; what was seen in each unit, by hashes of its moments, is for whoever compares two models."""
    return [{name: value for name, value in asdict(row).items() if name != "units"} for row in coverage]


def diagnostics(learned: Learned) -> dict[str, list[dict[str, Any]]]:
    """How the model came about, as plain values: the candidates' held-out scores, the fits, the bands' coverage."""
    fits = [asdict(location) for location in learned.locations if location.source != "unknown"]
    wanted = ("name", "source", "readings", "stays", "mu", "mu_error", "sigma", "k", "gains")
    return {
        "candidates": [asdict(candidate) for candidate in learned.candidates],
        "fits": [{name: fit[name] for name in wanted} for fit in fits],
        "held-out forecasts": coverage_rows(learned.coverage),
    }


def lsha_diagnostics(learned: LearnedLsha) -> dict[str, list[dict[str, Any]]]:
    """How the model came about, in short: the rivals, the locations, the edges and the check, the bands' coverage."""
    report = learned.report
    wanted = ("name", "flow", "entry", "segments", "readings", "seconds", "mu", "mu_error", "scatter", "rate")
    fits = [asdict(location) for location in report.locations]
    edges = {"observed": report.observed_edges, "default": report.default_edges, "queries": report.queries}
    checked = {"traces": report.acceptance.traces, "accepted": report.acceptance.accepted}
    events = {"events": report.acceptance.events, "of which compared for the flow": report.flow_events}
    return {
        "flow hypotheses": [asdict(flow) for flow in report.flows],
        "structures (errors in units of a segment's uncertainty)": [
            asdict(structure) for structure in report.structures
        ],
        "locations": [{name: fit[name] for name in wanted} for fit in fits],
        "edges and acceptance": [edges | checked | events],
        "held-out forecasts": coverage_rows(report.coverage),
    }
