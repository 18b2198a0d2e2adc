"""Method `lsha`: L*_SHA, a learner with an observation table and a teacher who answers from traces.

The order of things: words and segments (`words`, `segments`); which flow the plant has (`flow_hypotheses`); which words
lead to the same location (`merging`, chosen among rival structures by `structures`); the automaton (`automaton`); the
flow of single locations (`identify`); all parameters over the learned structure (`fitting`); stays, bands and the check
that every training trace is accepted.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.learning.calibrate import Coverage
from sim.learning.data import in_order
from sim.learning.lsha.automaton import Acceptance, Skeleton, acceptance, skeleton_of
from sim.learning.lsha.bands import bands
from sim.learning.lsha.build import Plan, fit, fitted_model, plan_of
from sim.learning.lsha.fitting import Fitted, LocationFit
from sim.learning.lsha.flow_hypotheses import Flowing, Rival, choose_flow
from sim.learning.lsha.ground import CYCLE, Ground, ground_of
from sim.learning.lsha.identify import Identified
from sim.learning.lsha.merging import Decision
from sim.learning.lsha.settings import LshaSettings
from sim.learning.lsha.structures import Structure, choose_structure
from sim.learning.lsha.table import ObservationTable, observation_table
from sim.learning.lsha.words import Word, described, spelled
from sim.learning.preparation import check_data, encoded, with_range
from sim.learning.structure import LearningError
from sim.sha.events import Alphabet, check_alphabet
from sim.sha.model import Model, Provenance
from sim.sha.trace import Trace

BUDGET, PART_BUDGET = 20_000, 5_000
"""Knots to which the runs are sampled for the last fit, and for the fits of the bands."""
ORIGINS = 25
"""Forecasts by which the bands of each part are judged."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True)
class RowOfWords:
    """A class of words: its name, the `word` if it is a single one, and where it was seen first.

    `trace` and the number of its `events` up to there give an example of such a word; `location` is where it leads.
    """

    name: str
    word: Word | None
    trace: str
    events: int
    location: str


@dataclass(frozen=True, slots=True)
class LshaReport:
    """How the model came about: the rivals, the queries and their answers, the table, the locations, the check.

    `rows` (C,) are the classes of words, which the decisions number. `spread` is the standard deviation of all
    segments' parameters, in which `delta` counts, `scatter` that from segment to segment after the same words. `level`
    is the p below which one hypothesis-test query of `queries` told two rows apart.
    """

    settings: LshaSettings
    flows: tuple[Rival, ...]
    structures: tuple[Rival, ...]
    delta: float
    spread: float
    scatter: float
    segments: int
    rows: tuple[RowOfWords, ...]
    decisions: tuple[Decision, ...]
    queries: int
    level: float
    identified: tuple[Identified, ...]
    table: ObservationTable
    locations: tuple[LocationFit, ...]
    observed_edges: int
    default_edges: int
    acceptance: Acceptance
    coverage: tuple[Coverage, ...]
    copies: int


@dataclass(frozen=True, slots=True)
class LearnedLsha:
    """A learned model, the raw parameter values of each location (for the histogram file) and how it came about."""

    model: Model
    values: Mapping[str, tuple[float, ...]]
    report: LshaReport


def learn_lsha(
    traces: Sequence[Trace],
    alphabet: Alphabet,
    temperature: str,
    *,
    seed: int,
    name: str = "lsha",
    settings: LshaSettings | None = None,
    data_hash: str = "",
    progress: Progress | None = None,
) -> LearnedLsha:
    """The automaton of the traces' words for the signal `temperature`, deterministic by construction.

    Traces without events are encoded by `alphabet`. The result depends on the traces' content and names, `seed` and the
    settings, not on the order of the traces; copies count once. `data_hash` defaults to the SHA-256 over their content.
    `progress` is told what is being done and the share that is done (0 to 1).

    Raises LearningError (a ValueError), in one sentence, when the traces cannot teach a model.
    """
    told = progress or (lambda _stage, _share: None)
    chosen = settings or LshaSettings()
    check_alphabet(alphabet)
    given = [encoded(trace, alphabet) for trace in traces if trace.times.size]
    ordered, digest = in_order(given)
    check_data(ordered, temperature)
    told("words and segments", 0.0)
    ground = ground_of(ordered, alphabet, temperature, chosen.n_min, chosen.split)
    asked = _ask(ground, chosen, told)
    told(f"fitting {asked.structure.partition.laws} locations", 0.6)
    plan = plan_of(
        name,
        temperature,
        ground=ground,
        flowing=asked.flowing,
        structure=asked.structure,
        skeleton=asked.skeleton,
        settings=chosen,
    )
    fitted, model = fitted_model(plan, ground, ordered, BUDGET)
    told("calibrating the bands", 0.8)
    coverage = bands(
        ground,
        ordered,
        temperature=temperature,
        fitted=lambda part: _part(plan, part, model),
        seed=seed,
        origins=ORIGINS,
    )
    checked = acceptance(asked.skeleton, ordered)
    if checked.failure:
        raise LearningError(f"the learned automaton does not accept {checked.failure}; this is a defect, report it")
    report = _report(
        ground,
        chosen,
        asked=asked,
        plan=plan,
        fitted=fitted,
        checked=checked,
        coverage=coverage,
        copies=len(given) - len(ordered),
    )
    origin = _origin(report, ordered, data_hash or digest, seed, asked)
    told("done", 1.0)
    model = replace(model, calibration={one.horizon: one.factor for one in coverage}, provenance=origin)
    return LearnedLsha(model, fitted.values, report)


@dataclass(frozen=True, slots=True)
class _Asked:
    """What the queries were answered: the flow, the structure, the rivals of both, and the automaton that follows."""

    flowing: Flowing
    flows: tuple[Rival, ...]
    structure: Structure
    structures: tuple[Rival, ...]
    skeleton: Skeleton


def _ask(ground: Ground, settings: LshaSettings, told: Progress) -> _Asked:
    """Both kinds of queries. Raises LearningError when no segment tells its parameter."""
    told("model-identification queries", 0.1)
    flowing, flows = choose_flow(ground, settings.default_flow, settings.alpha, settings.n_min)
    if not flowing.sample.value.size:
        raise LearningError(
            "no segment between two events has readings that tell its parameter; longer or denser traces are needed"
        )
    told("hypothesis-test queries", 0.35)
    structure, structures = choose_structure(ground, flowing.sample, settings)
    return _Asked(flowing, flows, structure, structures, skeleton_of(ground, structure, complete=settings.complete))


def _report(
    ground: Ground,
    settings: LshaSettings,
    *,
    asked: _Asked,
    plan: Plan,
    fitted: Fitted,
    checked: Acceptance,
    coverage: tuple[Coverage, ...],
    copies: int,
) -> LshaReport:
    partition, sample = asked.structure.partition, asked.flowing.sample
    return LshaReport(
        settings=settings,
        flows=asked.flows,
        structures=asked.structures,
        delta=asked.structure.delta,
        spread=sample.spread,
        scatter=sample.scatter,
        segments=int(sample.value.size),
        rows=_rows(ground, asked.structure, asked.skeleton),
        decisions=partition.decisions,
        queries=partition.queries,
        level=partition.level,
        identified=plan.identified,
        table=_table(asked.skeleton, asked.structure),
        locations=fitted.locations,
        observed_edges=len(asked.skeleton.observed),
        default_edges=len(asked.skeleton.default),
        acceptance=checked,
        coverage=coverage,
        copies=copies,
    )


def _part(plan: Plan, ground: Ground, whole: Model) -> Model:
    """The whole model with the parameters of a part of the readings."""
    fitted = fit(plan, ground, PART_BUDGET)
    return replace(whole, sha=with_range(fitted.sha, ground.runs, fitted.margin), sensor_sigma=fitted.sensor)


def _rows(ground: Ground, structure: Structure, skeleton: Skeleton) -> tuple[RowOfWords, ...]:
    """Every class of words: what it is called, where it was seen first, and the location that it leads to."""
    classes, words = structure.classes, ground.words
    first: dict[int, int] = {}
    for state, one in enumerate(classes.of_state.tolist()):
        first.setdefault(one, state)
    names = [skeleton.names[number] for number in structure.partition.location.tolist()]
    return tuple(
        RowOfWords(described(key, ground.alphabet), spelled(key, words), *words.first[first[number]], names[number])
        for number, key in enumerate(classes.keys)
    )


def _table(skeleton: Skeleton, structure: Structure) -> ObservationTable:
    suffixes = [decision.suffix for decision in structure.partition.decisions if decision.verdict == "new"]
    return observation_table(skeleton, suffixes, structure.partition.modelled)


def _origin(report: LshaReport, traces: Sequence[Trace], digest: str, seed: int, asked: _Asked) -> Provenance:
    return Provenance(
        method="lsha",
        data_hash=digest,
        traces=tuple(trace.name for trace in traces),
        synthetic=any(trace.synthetic for trace in traces),
        settings=_settings(report, seed, asked.flowing, asked.structure),
        scores=_scores(report),
    )


def _settings(
    report: LshaReport, seed: int, flowing: Flowing, structure: Structure
) -> dict[str, str | float | int | bool]:
    return {
        "seed": seed,
        "flow": flowing.hypothesis.label,
        "memory": structure.classes.memory,
        "delta": structure.delta,
        "alpha": report.settings.alpha,
        "n_min": report.settings.n_min,
        "split": report.settings.split,
        "complete": report.settings.complete,
        "cycle_s": CYCLE,
        "copies_left_out": report.copies,
        "locations_with_a_law": sum(structure.partition.modelled),
        "observed_edges": report.observed_edges,
        "default_edges": report.default_edges,
        "accepted": f"{report.acceptance.accepted} of {report.acceptance.traces} training traces",
    }


def _scores(report: LshaReport) -> dict[str, float]:
    row = next(row for row in report.flows if row.chosen)
    figures = {
        "held_out_log_likelihood": row.likelihood,
        "held_out_rmse": row.held_out_rmse,
        "held_out_mae": row.held_out_mae,
    }
    figures |= {f"coverage90_before_{one.horizon:.0f}s": one.covered for one in report.coverage}
    return {name: value for name, value in figures.items() if np.isfinite(value)}
