"""Method `lsha`: L*_SHA, a learner with an observation table and a teacher who answers from traces.

`learn_lsha` reads from top to bottom in the words of L* (Angluin 1987). The system under learning is not at hand: the
teacher knows its traces alone, so a query is answered by a statistical test over what was recorded, or not at all.

- membership query: what follows a word. The teacher's segments after it tell a flow (model-identification query) and a
  parameter (`segments`); whether two rows are alike is a hypothesis-test query (`evidence`).
- closedness, consistency: a row like no location becomes one; what is merged is merged with all that follows
  (`merging`). Nothing observed decides nothing, so the table is closed and consistent whatever is missing.
- hypothesis: the automaton of the merged rows (`hypothesis`), with its physical parameters (`fitting`).
- equivalence query: the hypothesis runs along every training trace. A trace that it does not accept would be a
  counterexample; since all words of the traces are rows from the beginning, it is a defect of the learner.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.effects import of_feature
from sim.lab.learning import (
    Coverage,
    LearningError,
    MachineSpread,
    check_data,
    in_order,
    observable_memories,
    with_events,
    with_range,
)
from sim.lab.learning.lsha.fitting import LshaLocationFit, bands, fit, fitted_model, plan_fit
from sim.lab.learning.lsha.flow_hypotheses import Contender, choose_flow, transfer_hypothesis
from sim.lab.learning.lsha.hypothesis import (
    HypothesisAutomaton,
    ObservationTable,
    TraceAcceptance,
    acceptance,
    build_hypothesis,
    observation_table,
)
from sim.lab.learning.lsha.identify import Identified
from sim.lab.learning.lsha.merging import Decision
from sim.lab.learning.lsha.settings import LshaSettings
from sim.lab.learning.lsha.structures import Structure, choose_structure
from sim.lab.learning.lsha.teacher import MIN_RUN_S, Teacher, beginnings, make_teacher
from sim.lab.learning.lsha.words import Word, class_word, describe_class
from sim.sha import Alphabet, Model, Provenance, Trace, check_alphabet, content_hash

BUDGET, PART_BUDGET = 20_000, 5_000
"""Knots to which the runs are sampled for the last fit, and for the fits of the bands."""
MAX_FLOW_EVENTS = 2_000
"""Events of the sample of traces on which the flow hypotheses are compared."""
FORECAST_COUNT = 60
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

    `flow_traces` and `flow_events` are the sample on which the flows were compared (all of them where that is how many
    there are). `rows` are the classes of words that the decisions are about, by number. `spread` is the standard
    deviation of all segments' parameters, in which `delta` counts, `scatter` that from segment to segment after the
    same words. `level` is the p below which one hypothesis-test query of `queries` told two rows apart.
    """

    settings: LshaSettings
    flows: tuple[Contender, ...]
    flow_traces: int
    flow_events: int
    structures: tuple[Contender, ...]
    delta: float
    spread: float
    scatter: float
    segments: int
    rows: Mapping[int, RowOfWords]
    decisions: tuple[Decision, ...]
    queries: int
    level: float
    identified: tuple[Identified, ...]
    table: ObservationTable
    locations: tuple[LshaLocationFit, ...]
    observed_edges: int
    default_edges: int
    acceptance: TraceAcceptance
    coverage: tuple[Coverage, ...]
    copies: int


@dataclass(frozen=True, slots=True)
class LearnedLsha:
    """A learned model, the raw parameter values of each location (for the histogram file), how it came about, and how
    far the targets of the machines lie apart."""

    model: Model
    values: Mapping[str, tuple[float, ...]]
    report: LshaReport
    spread: MachineSpread


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
    `progress` is called with what is being done and the share that is done (0 to 1).

    Raises LearningError (a ValueError), in one sentence, when the traces cannot teach a model.
    """
    report_progress = progress or (lambda _stage, _share: None)
    chosen = settings or LshaSettings()
    check_alphabet(alphabet)
    encoded_traces = [with_events(trace, alphabet) for trace in traces if trace.times.size]
    ordered, digest = in_order(encoded_traces)
    check_data(ordered, temperature)

    # The teacher: every word of the traces, and the segments that were measured after each.
    report_progress("words and segments", 0.0)
    teacher = make_teacher(ordered, alphabet, temperature, n_min=chosen.n_min, split=chosen.split)

    # Membership queries: which flow the segments follow, and each segment's parameter under it. The flow is a matter of
    # all segments alike, so a sample tells it; what follows from it is learned from everything.
    report_progress("model-identification queries", 0.1)
    if teacher.words.events > MAX_FLOW_EVENTS:
        sample = beginnings(ordered, MAX_FLOW_EVENTS, chosen.split)
        few = make_teacher(sample, alphabet, temperature, n_min=chosen.n_min, split=chosen.split)
        best, flows = choose_flow(few, chosen.default_flow, chosen.alpha, chosen.n_min)
        flowing = transfer_hypothesis(best.hypothesis, teacher, chosen.alpha, chosen.n_min)
    else:
        sample = ordered
        flowing, flows = choose_flow(teacher, chosen.default_flow, chosen.alpha, chosen.n_min)
    if not flowing.sample.value.size:
        raise LearningError(
            "no segment between two events has readings that tell its parameter; longer or denser traces are needed"
        )

    # The table is closed and made consistent under each memory and tolerance; held-out segments choose between them.
    report_progress("hypothesis-test queries", 0.35)
    structure, structures = choose_structure(teacher, flowing.sample, chosen)

    # The hypothesis, first its locations and edges, then their flows and laws.
    hypothesis = build_hypothesis(teacher, structure, complete=chosen.complete)
    report_progress(f"fitting {structure.partition.laws} locations", 0.6)
    plan = plan_fit(
        name,
        temperature,
        teacher=teacher,
        flowing=flowing,
        structure=structure,
        hypothesis=hypothesis,
        settings=chosen,
    )
    plan = replace(plan, memories=observable_memories(ordered, temperature))
    fitted, model = fitted_model(plan, teacher, ordered, BUDGET)

    # The equivalence query. Only observed edges count: default edges would accept anything.
    accepted = acceptance(hypothesis, ordered)
    if accepted.failure:
        raise LearningError(f"the learned automaton does not accept {accepted.failure}; this is a defect, report it")

    def refit_part(part: Teacher) -> Model:
        """The whole model with the parameters of a part of the readings, and as random as the whole one."""
        fewer = fit(replace(plan, memories=fitted.memories), part, PART_BUDGET)
        kept = (*of_feature(fewer.sha, "disturbance"), *of_feature(model.sha, "machine offset"))
        sha = with_range(replace(fewer.sha, effects=kept), part.runs, fewer.margin)
        return replace(model, sha=sha, sensor_sigma=fewer.sensor, sensor_memory=fewer.sensor_memory)

    report_progress("calibrating the bands", 0.8)
    forecasts = bands(teacher, ordered, temperature=temperature, fitted=refit_part, seed=seed, origins=FORECAST_COUNT)
    coverage = forecasts.coverage
    partition = structure.partition
    suffixes = [decision.suffix for decision in partition.decisions if decision.verdict == "new"]
    report = LshaReport(
        settings=chosen,
        flows=flows,
        flow_traces=len(sample),
        flow_events=sum(len(trace.events) for trace in sample),
        structures=structures,
        delta=structure.delta,
        spread=flowing.sample.spread,
        scatter=flowing.sample.scatter,
        segments=int(flowing.sample.value.size),
        rows=_rows(teacher, structure, hypothesis),
        decisions=partition.decisions,
        queries=partition.queries,
        level=partition.level,
        identified=plan.identified,
        table=observation_table(hypothesis, suffixes, partition.modelled),
        locations=fitted.locations,
        observed_edges=len(hypothesis.observed),
        default_edges=len(hypothesis.default),
        acceptance=accepted,
        coverage=coverage,
        copies=len(encoded_traces) - len(ordered),
    )
    flow = next(row for row in flows if row.chosen)
    figures = {
        "held_out_log_likelihood": flow.likelihood,
        "held_out_rmse": flow.held_out_rmse,
        "held_out_mae": flow.held_out_mae,
    }
    figures |= {f"coverage90_before_{row.horizon:.0f}s": row.covered for row in coverage}
    figures |= {f"crps_{row.horizon:.0f}s": row.crps for row in coverage}
    provenance = Provenance(
        method="lsha",
        data_hash=data_hash or digest,
        traces=tuple(sorted(trace.name for trace in ordered)),
        contents=tuple(sorted(content_hash(trace) for trace in ordered)),
        synthetic=any(trace.synthetic for trace in ordered),
        settings={
            "seed": seed,
            "flow": flowing.hypothesis.label,
            "memory": structure.classes.memory,
            "delta": structure.delta,
            "alpha": chosen.alpha,
            "n_min": chosen.n_min,
            "split": chosen.split,
            "complete": chosen.complete,
            "cycle_s": MIN_RUN_S,
            "copies_left_out": report.copies,
            "locations_with_a_law": sum(partition.modelled),
            "flow_events": report.flow_events,
            "observed_edges": report.observed_edges,
            "default_edges": report.default_edges,
            "accepted": f"{accepted.accepted} of {accepted.traces} training traces",
        },
        # JSON has no NaN: a figure for which there were too few data is left out of the model's file.
        scores={name: value for name, value in figures.items() if np.isfinite(value)},
    )
    report_progress("done", 1.0)
    whole = replace(
        model,
        calibration=forecasts.calibration,
        plain=forecasts.members,
        anomalies=forecasts.scores.record,
        provenance=provenance,
    )
    return LearnedLsha(whole, fitted.values, report, fitted.spread)


def _rows(teacher: Teacher, structure: Structure, hypothesis: HypothesisAutomaton) -> dict[int, RowOfWords]:
    """The classes of words in the decisions: what each is called, where it was seen first, where it leads."""
    classes, words = structure.classes, teacher.words
    first: dict[int, int] = {}
    for state, row in enumerate(classes.of_state.tolist()):
        first.setdefault(row, state)
    decisions = structure.partition.decisions
    named = {number for each in decisions for number in (each.row, each.other, each.rival) if number is not None}
    place = structure.partition.location
    return {
        number: RowOfWords(
            describe_class(classes.keys[number], teacher.alphabet),
            class_word(classes.keys[number], words),
            *words.first[first[number]],
            hypothesis.names[place[number]],
        )
        for number in sorted(named)
    }
