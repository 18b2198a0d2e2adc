"""A retraining from the historian to a proposal, in steps that are each kept when they are done.

A kill at any moment leaves the store as it was, or with one version more that nobody has promoted; the same command
goes on with the step that was not done. What a step gives depends on data, settings and seed alone.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from math import inf, isnan, nan
from pathlib import Path
from typing import Any

import numpy as np

from gateway.entry import sentence as error_sentence
from gateway.lab.judging.figures import LONGEST_HORIZON, MAX_FORECASTS_PER_CYCLE, score_trace
from gateway.lab.learning.familiar import (
    ErrorPair,
    cycles_with_points,
    error_pair,
    familiarity,
    familiarity_files,
    make_reference,
    strange_words,
)
from gateway.lab.options import RATINGS
from gateway.lab.retraining.cutting import CycleSource, cut_new, extend_cycle, read_cycle
from gateway.lab.retraining.cycle_library import CycleLibrary, CycleRow
from gateway.lab.retraining.report import Retraining, report_files
from gateway.lab.retraining.training_record import RECORD, TrainingRecord, code_hash, read_record, software
from gateway.store import oldest_scan, parse_moment, reading
from sim.artefacts import (
    MANIFEST,
    MODEL_FILE,
    VERDICT_FILE,
    Familiarity,
    current,
    load,
    model_hash,
    objections,
    read_familiarity,
    read_hashes,
    read_model,
    read_verdict,
    version_directory,
    versions,
)
from sim.familiarity import ClassFigures, measured_classes
from sim.files import replace_durably
from sim.lab.discrepancy import diagnose
from sim.lab.formats import save, write_model_directory
from sim.lab.judge import (
    TraceJob,
    TraceRunSettings,
    compare_horizons,
    judge_learning,
    propose_verdict,
    rank,
    run_job,
)
from sim.lab.tuning import METHODS, Settings, StudyPlan, Task, Taught, tune
from sim.proof import verify
from sim.sha import Model, Trace, content_hash, encode_trace, joint_hash

Progress = Callable[[str, float], None]

MAX_HELD_OUT, MIN_HELD_OUT = 12, 8
"""New cycles that are held out at most, and how many a paired test needs to say anything."""
MIN_NEW_CYCLES = 2 * MIN_HELD_OUT
"""New cycles below which a retraining is refused."""
MAX_JUDGED_CYCLES = 4 * MAX_HELD_OUT
"""The newest of the new cycles, a quarter of which is held out: a model is to forecast the plant as it is now."""
RECENT_ROOM_FACTOR = 2.0
"""Times the room of a training that the cycles have together that are learned from before any older one."""
RETUNE_SHARE = 0.2
"""The share of new cycles badly predicted from which settings are searched anew; where a model is right it is 0.1."""
DIAGNOSIS_PERIOD_S = 10.0
"""Seconds between the rows that a diagnosis is given."""
FRESH, STANDARD = "new cycles", "standard set"
STUDIES, REPORTS = "studies", "reports"


@dataclass(frozen=True, slots=True, kw_only=True)
class RetrainingRequest:
    """What is retrained: the current version of a `store`, from a machine's `historian` since a date or span.

    `standard` are the traces that a new model must not be worse on, `former` those of earlier training that no library
    has; both encoded by nobody yet. `rows` is how many scans the training has at most, `trials` those of a search of
    settings where performance has fallen: where S is above `score_limit` (per cent of the readings), or without one
    where more than RETUNE_SHARE of the new cycles are badly predicted. `yellow` and `red` are the classes of expected
    relative error; `forecasts` is by how many forecasts a cycle judges at most.
    """

    store: Path
    historian: Path
    machine: str | None
    since: str | None
    standard: Sequence[Trace]
    former: Sequence[Trace]
    method: str | None
    seed: int
    rows: int
    trials: int
    diagnosis: bool
    yellow: float
    red: float
    score_limit: float | None = None
    forecasts: int = MAX_FORECASTS_PER_CYCLE


def make_source(request: RetrainingRequest, last: float) -> CycleSource:
    """The historian as the current version's alphabet cuts it. Raises ArtefactError without a current version."""
    version = current(request.store)
    since = -inf if request.since is None else parse_moment(request.since, last)
    return CycleSource(
        historian=request.historian,
        machine=request.machine,
        model=load(request.store, version),
        version=version,
        since=since,
    )


def cut_and_rate(request: RetrainingRequest, library: CycleLibrary, source: CycleSource, report: Progress) -> int:
    """Cut what is new into cycles and rate it by what the current version was trained on; how many came.

    For a version that does not say what is familiar to it the older half of the library counts as that.
    """
    known = read_familiarity(version_directory(request.store, source.version))
    if known is not None:
        return cut_new(library, source, known.reference, report)
    count = cut_new(library, source, None, report)
    cycles = [row for row in library.cycles() if not row.is_excluded]
    half = len(cycles) // 2
    reference = make_reference([row.points for row in cycles[:half]])
    if reference is None:
        return count
    for row in cycles[half:]:
        strange = reference.strangeness(row.points, np.arange(len(row.points), dtype=float))
        if row.rating == "ordinary" and strange.value > 1.0:
            trace = read_cycle(source, row, library)
            if trace is not None:
                library.keep(row.name, trace)
            library.rate(row.name, "rare", strange_words(strange), strange.value)
        else:
            library.rate(row.name, row.rating, row.words, strange.value)
    return count


def new_cycles(library: CycleLibrary, model: Model) -> list[CycleRow]:
    """The cycles since the last one that the model was learned from, which nobody has excluded and which can be run."""
    seen, rows = set(model.provenance.contents), library.cycles(as_cut=True)
    # One that was left out of that training is no news: it tells of the plant as it was then.
    last = max((place for place, row in enumerate(rows) if row.content in seen), default=-1)
    return [row for row in rows[last + 1 :] if not row.is_excluded and row.error is not None]


@dataclass(frozen=True, slots=True)
class Due:
    """Whether it is time to retrain: the `reason`, "" where it is not, and what was found about S, "" if not asked."""

    reason: str
    score: str = ""


def due(
    request: RetrainingRequest,
    library: CycleLibrary,
    source: CycleSource,
    *,
    after: int,
    drifting: bool,
    age: float,
    every: float,
) -> Due:
    """Whether it is time to retrain, and why.

    Reasons are drift, `after` new cycles that teach, S above the limit of the `request`, the last one's age (s).
    """
    if drifting:
        return Due("the drift alarm's condition holds")
    fresh = _cycles_since_last(library, source.model)
    teaching = sum(row.rating != "ordinary" for row in fresh)
    if teaching >= after:
        return Due(f"{teaching} new cycles are not ordinary")
    if age >= every:
        return Due(f"the last retraining is {age / 86_400.0:.3g} days ago")
    if request.score_limit is None:
        return Due("")
    # What it was before the last retraining is no reason for another one.
    if len(fresh) < MIN_HELD_OUT:
        cycles = "cycle" if len(fresh) == 1 else "cycles"
        return Due(
            "", f"S not looked at ({len(fresh)} new {cycles} since the last retraining; it takes {MIN_HELD_OUT})"
        )
    fallen, said = _has_fallen(request, library, source)
    return Due(said if fallen else "", said)


def _cycles_since_last(library: CycleLibrary, model: Model) -> list[CycleRow]:
    """The new cycles that came after the last retraining, whatever became of that."""
    names = [row.name for row in library.cycles(as_cut=True)]
    finished = (library.fact("finished") or {}).get("last")
    since = set(names[names.index(finished) + 1 :] if finished in names else names)
    return [row for row in new_cycles(library, model) if row.name in since]


def score_percent(library: CycleLibrary, source: CycleSource, cycles: Sequence[CycleRow]) -> tuple[float, int]:
    """(S of the current version's free run, of how many cycles): the "S %" of `model judge rank`, by its weights.

    In per cent of the readings, a mean over the newest MAX_HELD_OUT of the `cycles` that are kept or in the historian
    still and read anything but 0; NaN where the version cannot be run along any of them.
    """
    results = []
    # Two runs: S is of the mean alone, and the band that more of them would draw is not asked for.
    settings = TraceRunSettings(runs=2)
    for row in cycles[-MAX_HELD_OUT:]:
        trace = read_cycle(source, row, library)
        if trace is not None:
            job = TraceJob(label="present", semantics="", model=source.model, trace=trace, settings=settings)
            results.append(run_job(job).result)
    if not results:
        return nan, 0
    standing = rank(results).standings[0]
    return standing.score_percent, standing.percent_traces


def _has_fallen(request: RetrainingRequest, library: CycleLibrary, source: CycleSource) -> tuple[bool, str]:
    """Whether settings are to be searched since the current version performs badly on the new cycles, and by what."""
    fresh = new_cycles(library, source.model)
    if request.score_limit is None:
        share = sum(row.rating == "badly predicted" for row in fresh) / max(len(fresh), 1)
        return share > RETUNE_SHARE, f"{share:.0%} of the new cycles are badly predicted (limit {RETUNE_SHARE:.0%})"
    # The same cycles that made the retraining due, where they are enough for that.
    latest = _cycles_since_last(library, source.model)
    looked_at = (latest if len(latest) >= MIN_HELD_OUT else fresh)[-MAX_HELD_OUT:]
    percent, count = score_percent(library, source, looked_at)
    if isnan(percent):
        return False, "S of the current version is not known on any new cycle"
    said = f"S of the current version is {percent:.3g} % of the readings on {count} new cycles"
    if count < len(looked_at):
        said += f" ({len(looked_at) - count} more have none: no readings but 0, or the version cannot be run there)"
    return percent > request.score_limit, f"{said} (limit {request.score_limit:g} %)"


def retrain(
    request: RetrainingRequest,
    library: CycleLibrary,
    source: CycleSource,
    *,
    report: Progress,
    clock: Callable[[], float],
) -> Retraining:
    """Learn a new model beside the current one, judge both, and save the new one as a version if it is better.

    Nothing is promoted. Raises ValueError in one sentence where the cycles are too few, or teach no model.
    """
    present = source.model
    standard = [encode_trace(trace, present.alphabet) for trace in request.standard]
    method = request.method or (present.provenance.method if present.provenance.method in METHODS else "bins")
    settings = {
        "store": str(request.store.resolve()),
        "version": source.version,
        "model": model_hash(present),
        "method": method,
        "seed": request.seed,
        "rows": request.rows,
        "trials": request.trials,
        "score_limit": request.score_limit,
        "diagnosis": request.diagnosis,
        "forecasts": request.forecasts,
        "standard": joint_hash(request.standard),
        "former": joint_hash(request.former),
        # What somebody has taken out since the study began must not be in what it learns from.
        "excluded": [row.name for row in library.cycles() if row.is_excluded],
        "code": code_hash(),
    }
    study = library.study(settings)
    folder = library.folder / STUDIES / f"{study:04d}"
    folder.mkdir(parents=True, exist_ok=True)

    chosen = library.step(study, "sets")
    if chosen is None:
        report("choosing cycles", 0.1)
        chosen = choose_cycles(request, library, source)
        library.done(study, "sets", chosen)
    training = [replace(trace, events=()) for trace in _former(request, chosen)]
    training += [library.readings(content) for _, content in chosen["training"]]

    learned = library.step(study, "learned")
    if learned is None:
        settings_found: Settings = {}
        tuned = ""
        if request.trials:
            fallen, why = _has_fallen(request, library, source)
            tuned = f"not searched: {why}"
            if fallen:
                report("searching settings", 0.15)
                settings_found, found_sentence = _search_settings(request, present, method, training, folder)
                tuned = f"searched, as {why}: {found_sentence}"
        report(f"learning ({method})", 0.25)
        record = _record(request, source, method, chosen, settings=settings_found)
        taught = learned_model(record, training, present)
        whole = [encode_trace(trace, taught.model.alphabet) for trace in join_traces(training, present.alphabet.gap)]
        verdict = judge_learning(taught.model, whole, taught.coverage)
        write_model_directory(folder / "model", taught.model, taught.values, more={VERDICT_FILE: verdict.text()})
        rows_learned = sum(trace.times.size for trace in training)
        learned = {"settings": settings_found, "rows": rows_learned, "tuned": tuned}
        library.done(study, "learned", learned)
    new = read_model(folder / "model")
    del training

    scores: dict[str, list[dict[str, Any]]] = {FRESH: [], STANDARD: []}
    notes, unjudged = list[str](), list[str]()
    judged: list[tuple[str, Trace | None, str]] = [(FRESH, None, content) for _, content in chosen["held_out"]]
    judged += [(STANDARD, trace, content_hash(trace)) for trace in standard]
    for number, (subject, at_hand, content) in enumerate(judged):
        rows = library.step(study, f"judged {content}")
        if rows is None:
            share = 0.4 + 0.4 * number / len(judged)
            cycle = at_hand if at_hand is not None else library.readings(content)
            until = float(cycle.times[-1])
            trace = cycle
            if at_hand is None:
                trace = encode_trace(extend_cycle(source, cycle, LONGEST_HORIZON), present.alphabet)

            def tell(what: str, _share: float, share: float = share) -> None:
                report(what, share)

            try:
                rows = score_trace(
                    trace, present, new, seed=request.seed, report=tell, most=request.forecasts, until=until
                )
            except ValueError as error:
                notes.append(f"{trace.name} cannot be judged: {error_sentence(error)}")
                rows = []
            library.done(study, f"judged {content}", rows)
        if subject == STANDARD and content in (*present.provenance.contents, *new.provenance.contents):
            name = at_hand.name if at_hand is not None else content[:8]
            notes.append(f"{name} of the standard set is training of one of the models: its figures flatter that one")
        if at_hand is not None and not rows:
            unjudged.append(f"{at_hand.name} of the {STANDARD}")
        scores[subject] += rows
    comparisons = [
        each for subject, rows in scores.items() for each in compare_horizons(subject, rows, seed=request.seed)
    ]

    report("verifying", 0.8)
    refusals = objections(verify(new).reasons, read_verdict(folder / "model"))
    propose, sentence = propose_verdict(comparisons, refusals, FRESH, unjudged)
    left = library.step(study, "diagnosed")
    if left is None:
        left = "" if not request.diagnosis else _describe_residue(new, library, chosen, request.seed, report)
        library.done(study, "diagnosed", left)

    rows_by_name = {row.name: row for row in library.cycles()}
    familiar, classes = _familiarity(request, library, chosen, rows_by_name, new)
    key = sha256(json.dumps([settings, chosen], sort_keys=True).encode()).hexdigest()
    record = _record(request, source, method, chosen, settings=learned["settings"], study=key)
    found = Retraining(
        study=study,
        machine=source.machine or "",
        temperature=present.temperature,
        unit=present.unit,
        present=source.version,
        new_hash=model_hash(new),
        version="",
        proposed=propose,
        sentence=sentence,
        comparisons=tuple(comparisons),
        scores=tuple({"set": subject, **row} for subject, rows in scores.items() for row in rows),
        refusals=tuple(refusals),
        left=left,
        classes=tuple(classes),
        regions=_regions(library, chosen),
        ratings={
            rating: sum(row.rating == rating and not row.is_excluded for row in rows_by_name.values())
            for rating in RATINGS
        },
        training=len(record.training),
        held_out=len(chosen["held_out"]),
        rows=learned["rows"],
        tuned=learned["tuned"],
        notes=(*notes, *chosen["notes"]),
    )
    report("writing the report", 0.95)
    files = report_files(found, rows_by_name.values(), frozenset(name for name, _ in chosen["training"]))
    if propose:
        # Known again by its study: a kill between the store and the library must not make a second version.
        made = next(
            (name for name in versions(request.store) if _version_study(request.store, name) == record.study), None
        )
        if made is None:
            more = _directory_files(folder / "model") | files | {RECORD: record.text()}
            more |= familiarity_files(familiar)
            made = save(request.store, new, created=clock(), parent=source.version, more=more)
        found = replace(found, version=made)
    place = library.folder / REPORTS / f"{study:04d}"
    place.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        replace_durably(place / name, content)
    last = next((row.name for row in reversed(library.cycles(as_cut=True))), None)
    library.set_fact("finished", {"last": last, "at": clock(), "study": study, "version": found.version})
    library.close_study(study)
    shutil.rmtree(folder, ignore_errors=True)
    return found


def choose_cycles(request: RetrainingRequest, library: CycleLibrary, source: CycleSource) -> dict[str, Any]:
    """Which cycles are held out and which are learned from, (name, content hash) each; all of them are kept by then.

    Held out are some of the newest new cycles, evenly over ratings and time. The training takes cycles of each region
    of operation in turn, the newest before the older, then the traces of former training, until it has as many rows as
    it may have.
    """
    with reading(source.historian) as connection:
        oldest = oldest_scan(connection, machine=source.machine)
    # One that nobody has any more must not be drawn: only ordinary ones go.
    fresh = [
        row for row in new_cycles(library, source.model) if row.kept or (oldest is not None and row.begin >= oldest)
    ]
    latest = fresh[-MAX_JUDGED_CYCLES:]
    count = min(max(len(latest) // 4, MIN_HELD_OUT), MAX_HELD_OUT, len(latest) // 2)
    if count < MIN_HELD_OUT:
        raise ValueError(
            f"{library.folder}: {len(fresh)} new cycles are too few to learn from and to judge by; it takes "
            f"{MIN_NEW_CYCLES}, so let the gateway run on"
        )
    ordered = sorted(latest, key=lambda row: (RATINGS.index(row.rating), row.begin))
    # In the middle of each part, not at its ends: the one that is worst predicted would always be among the judges.
    places = ((np.arange(count) + 0.5) * len(ordered) / count).astype(int).tolist()
    held = {ordered[place].name for place in places}
    rows = library.cycles(as_cut=True)
    rest = [row for row in rows if not row.is_excluded and row.error is not None and row.name not in held]
    notes, sets = list[str](), {"training": list[tuple[str, str]](), "held_out": list[tuple[str, str]]()}
    former, left = list[str](), request.rows
    # No library has them, so that they are older than all that it has.
    earlier = sorted(request.former, key=lambda trace: float(trace.times[0]), reverse=True)
    candidates: list[CycleRow | Trace] = [row for row in ordered if row.name in held]
    candidates += [*_training_order(rest, request.rows), *earlier]
    for row in candidates:
        if isinstance(row, Trace):
            begin, end = float(row.times[0]), float(row.times[-1])
            same = row.machine in ("", source.machine)
            if same and any(begin <= each.until and each.begin <= end for each in rows):
                notes.append(
                    f"{row.name} is of a time that the library has cycles of: it is not learned from beside them"
                )
            elif row.times.size <= left:
                former.append(content_hash(row))
                left -= row.times.size
            continue
        subject = "held_out" if row.name in held else "training"
        if subject == "training" and row.rows > left:
            continue
        trace = read_cycle(source, row, library)
        if trace is None:
            notes.append(f"{row.name} is neither kept nor in the historian any more")
            continue
        library.keep(row.name, replace(trace, events=()))
        sets[subject].append((row.name, row.content))
        left -= row.rows if subject == "training" else 0
    for pairs in sets.values():
        pairs.sort()
    return {**sets, "former": former, "notes": notes}


def _former(request: RetrainingRequest, chosen: dict[str, Any]) -> list[Trace]:
    """The traces of former training that there was room for."""
    return [trace for trace in request.former if content_hash(trace) in chosen["former"]]


def _training_order(cycles: Sequence[CycleRow], room: int) -> list[CycleRow]:
    """The cycles, given in the order of time, so that any number of first ones has all regions, and of each the newest.

    One that is older than the newest RECENT_ROOM_FACTOR times `room` rows (scans) comes after all of these, but for the
    newest of a region that the plant has not been in since: a plant that was changed is learned as it is, and nothing
    that it once did is forgotten (record 0145). How wrong the present model was is no reason to be learned from: a
    model of those cycles alone is wrong the other way (record 0145).
    """
    turn: dict[str, int] = {}
    placed: list[tuple[bool, int, CycleRow]] = []
    rows = 0
    for row in reversed(cycles):
        number = turn.setdefault(row.region, 0)
        placed.append((number > 0 and rows >= RECENT_ROOM_FACTOR * room, number, row))
        turn[row.region] += 1
        rows += row.rows
    return [row for *_, row in sorted(placed, key=lambda each: each[:2])]


def _search_settings(
    request: RetrainingRequest, present: Model, method: str, training: Sequence[Trace], folder: Path
) -> tuple[Settings, str]:
    """The settings of a search by cross-validation over the training, none where the defaults are as good; a sentence.

    The search is a study of its own in `folder`, which goes on where it was killed.
    """
    plan = StudyPlan(method, "crps", 5, request.seed)
    found = tune(training, present.alphabet, present.temperature, plan, folder / "tuning.db", trials=request.trials)
    best = found.best.settings if found.better and found.best is not None else {}
    return dict(best), found.sentence


def learned_model(record: TrainingRecord, training: Sequence[Trace], like: Model) -> Taught:
    """The model that a record says, from its `training` (traces without events); the same whenever it is asked for.

    Its alphabet, temperature and signals' roles are those of the model `like`. Cycles that follow one another are
    learned from as one trace, or no model would ever see a rest end. Raises ValueError where they teach none.
    """
    # Traces that do not say their machine are of the historian's: named beside unnamed would be two machines.
    if any(not trace.machine for trace in training):
        training = [replace(trace, machine="") for trace in training]
    task = Task(join_traces(training, like.alphabet.gap), like.alphabet, like.temperature, record.seed, record.name)
    taught = METHODS[record.method].learn(task, record.settings)
    contents = tuple(sorted({content for _, content in record.training}))
    names = tuple(name for name, _ in record.training)
    origin = replace(taught.model.provenance, parent=record.parent_hash, contents=contents, traces=names)
    return replace(taught, model=replace(taught.model, provenance=origin, roles=like.roles))


def join_traces(traces: Sequence[Trace], gap: float) -> list[Trace]:
    """The traces in the order of time, those of the same signals that follow within `gap` s as one.

    The row that ended a cycle is the first of the next one: it comes once.
    """
    groups: list[list[Trace]] = []
    for trace in sorted(traces, key=lambda each: (each.times[0], each.name)):
        before = groups[-1][-1] if groups else None
        follows = before is not None and 0 <= trace.times[0] - before.times[-1] <= gap
        if (
            before is not None
            and follows
            and [set(of) for of in (trace.signals, trace.bad, trace.held)]
            == [set(of) for of in (before.signals, before.bad, before.held)]
        ):
            if before.times[-1] == trace.times[0]:
                groups[-1][-1] = before.between(float(before.times[0]), float(trace.times[0]))
            groups[-1].append(trace)
        else:
            groups.append([trace])
    return [
        replace(
            group[0],
            times=np.concatenate([each.times for each in group]),
            signals={name: np.concatenate([each.signals[name] for each in group]) for name in group[0].signals},
            bad={name: np.concatenate([each.bad[name] for each in group]) for name in group[0].bad},
            held={name: np.concatenate([each.held[name] for each in group]) for name in group[0].held},
        )
        for group in groups
    ]


def _record(
    request: RetrainingRequest,
    source: CycleSource,
    method: str,
    chosen: dict[str, Any],
    *,
    settings: Settings,
    study: str = "",
) -> TrainingRecord:
    """The record of the model that is learned from what was chosen."""
    return TrainingRecord(
        name=source.model.sha.name,
        method=method,
        settings=settings,
        seed=request.seed,
        parent=source.version,
        parent_hash=model_hash(source.model),
        training=(
            *((trace.name, content_hash(trace)) for trace in _former(request, chosen)),
            *((name, content) for name, content in chosen["training"]),
        ),
        code=code_hash(),
        software=software(),
        study=study,
    )


def sparse(trace: Trace, step: float) -> Trace:
    """The first row of every `step` s, with all events."""
    kept = np.unique(np.floor((trace.times - trace.times[0]) / step), return_index=True)[1]
    signals = {name: column[kept] for name, column in trace.signals.items()}
    bad = {name: mask[kept] for name, mask in trace.bad.items()}
    held = {name: mask[kept] for name, mask in trace.held.items()}
    return replace(trace, times=trace.times[kept], signals=signals, bad=bad, held=held)


def _describe_residue(new: Model, library: CycleLibrary, chosen: dict[str, Any], seed: int, report: Progress) -> str:
    """What a diagnosis says of the new model on the cycles held out: where it still disagrees, if it does."""
    # Heat is slow: at a row every ten seconds a diagnosis sees the same, in a tenth of the memory of 1 Hz.
    traces = [
        sparse(encode_trace(library.readings(content), new.alphabet), DIAGNOSIS_PERIOD_S)
        for _, content in chosen["held_out"]
    ]
    found = diagnose(new, traces, seed=seed, most=1, progress=lambda what, _: report(f"diagnosing: {what}", 0.85))
    return f"{found.diagnosis.verdict}: {found.diagnosis.sentence}"


def _familiarity(
    request: RetrainingRequest,
    library: CycleLibrary,
    chosen: dict[str, Any],
    rows: dict[str, CycleRow],
    new: Model,
) -> tuple[Familiarity | None, list[ClassFigures]]:
    """What is familiar to the new model, and its error on the cycles held out by the class that was expected."""
    # In the order of time: no library has the traces of former training, so that they are older.
    known = [
        points
        for trace in sorted(_former(request, chosen), key=lambda each: float(each.times[0]))
        for _, points in cycles_with_points(new, encode_trace(trace, new.alphabet))
    ]
    known += [rows[name].points for name, _ in chosen["training"]]
    reference = make_reference(known)
    if reference is None:
        return None, []
    pairs: list[ErrorPair] = []
    for name, content in chosen["held_out"]:
        pair = error_pair(reference, new, encode_trace(library.readings(content), new.alphabet), rows[name].points)
        if pair is not None:
            pairs.append(pair)
    found = familiarity(reference, pairs, held_out=True)
    return found, measured_classes(pairs, request.yellow, request.red) if pairs else []


def _regions(library: CycleLibrary, chosen: dict[str, Any]) -> tuple[dict[str, Any], ...]:
    """By region of operation: how many cycles there are, how many are not ordinary, how many the training has."""
    trained = {name for name, _ in chosen["training"]}
    found: dict[str, dict[str, Any]] = {}
    for row in library.cycles():
        if row.is_excluded:
            continue
        own = found.setdefault(row.region, {"region": row.region, "cycles": 0, "not ordinary": 0, "in training": 0})
        own["cycles"] += 1
        own["not ordinary"] += row.rating != "ordinary"
        own["in training"] += row.name in trained
    return tuple(sorted(found.values(), key=lambda own: -own["cycles"]))


def _directory_files(directory: Path) -> dict[str, str]:
    """The files of a model directory beside the model itself, by name."""
    names = [name for name in read_hashes(directory / MANIFEST) if name != MODEL_FILE]
    return {name: (directory / name).read_text(encoding="utf-8") for name in names}


def _version_study(store: Path, version: str) -> str:
    record = read_record(version_directory(store, version))
    return "" if record is None else record.study
