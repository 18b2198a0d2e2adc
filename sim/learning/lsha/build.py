"""The model of a learned structure: parameters, sensor, stays; for all readings, or for a part of them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sim.learning.free_run import fit_free_run
from sim.learning.held_out import choose, cross_validate, folds
from sim.learning.lsha.automaton import Skeleton
from sim.learning.lsha.evidence import sample_of
from sim.learning.lsha.fitting import Fitted, fit_levels, fit_motion
from sim.learning.lsha.flow_hypotheses import BUDGET, Flowing, flow_shape, flows_of, positions
from sim.learning.lsha.ground import Ground, alike, placed
from sim.learning.lsha.identify import Identified, identify
from sim.learning.lsha.segments import levels
from sim.learning.lsha.settings import LshaSettings
from sim.learning.lsha.structures import Structure
from sim.learning.lsha.words import described
from sim.learning.preparation import initial_law, with_range
from sim.learning.runs import sampled
from sim.learning.semi_markov import fit_stays
from sim.sha.model import Model
from sim.sha.trace import Trace


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A structure ready to be fitted: the flow of each location (`kinds`) and the words that lead there (`words`)."""

    name: str
    temperature: str
    flowing: Flowing
    skeleton: Skeleton
    modelled: Sequence[bool]
    kinds: tuple[str, ...]
    words: tuple[tuple[str, ...], ...]
    identified: tuple[Identified, ...]


def plan_of(
    name: str,
    temperature: str,
    *,
    ground: Ground,
    flowing: Flowing,
    structure: Structure,
    skeleton: Skeleton,
    settings: LshaSettings,
) -> Plan:
    """The plan, with the model-identification queries of the single locations answered."""
    size, kind = structure.partition.size, flowing.hypothesis.kind
    keys = structure.classes.keys
    words = tuple(
        tuple(dict.fromkeys(described(keys[one], ground.alphabet) for one in mine)) for mine in skeleton.members
    )
    plan = Plan(
        name=name,
        temperature=temperature,
        flowing=flowing,
        skeleton=skeleton,
        modelled=structure.partition.modelled,
        kinds=(kind,) * size,
        words=words,
        identified=(),
    )
    if flowing.given is None:
        return plan  # under `resample` there is nothing to ask: a level is a level
    motion, alternatives = flows_of(flowing, ground)
    runs = placed(ground.runs, skeleton.place)
    answers = identify(
        runs, size, default=kind, motion=motion, alternatives=alternatives, alpha=settings.alpha, n_min=settings.n_min
    )
    return _confirmed(plan, answers, ground)


def _confirmed(plan: Plan, answers: tuple[Identified, ...], ground: Ground) -> Plan:
    """Flows of single locations are only taken if the held-out free runs do not get worse by them."""
    kinds = list(plan.kinds)
    for answer in answers:
        kinds[answer.location] = answer.kind
    mixed = replace(plan, kinds=tuple(kinds), identified=answers)
    if mixed.kinds == plan.kinds:
        return mixed
    few = sampled(placed(ground.runs, plan.skeleton.place), BUDGET)
    cut = folds(few)
    scores, sizes = [], []
    for one in (plan, mixed):
        where = positions(ground, plan.skeleton.place, len(plan.kinds))
        shape, _ = flow_shape(plan.flowing.hypothesis, ground, where, plan.modelled, one.kinds)
        sizes.append(shape.centre.size + shape.rate_centre.size)
        if cut is not None:
            scores.append(cross_validate(cut, shape, fit_free_run(few, shape).rates, fixed=True))
    if len(scores) == 2 and scores[1].score > scores[0].score and choose(scores, [1, 2]) == 1:
        return mixed
    refused = tuple(replace(answer, kept=True, kind=answer.default) for answer in answers)
    return replace(plan, identified=refused)


def fitted_model(plan: Plan, ground: Ground, traces: Sequence[Trace], budget: int) -> tuple[Fitted, Model]:
    """All parameters by the readings of `ground`, and the model with the stays of `traces`."""
    fitted = fit(plan, ground, budget)
    model = Model(
        sha=with_range(fitted.sha, ground.runs, fitted.margin),
        alphabet=ground.alphabet,
        temperature=plan.temperature,
        sensor_sigma=fitted.sensor,
        initial=initial_law(traces, plan.temperature),
    )
    return fitted, replace(model, semi_markov=fit_stays(model, traces))


def fit(plan: Plan, ground: Ground, budget: int) -> Fitted:
    """All parameters of the automaton by the readings of `ground`."""
    if plan.flowing.given is None:
        sample = sample_of(levels(ground.runs, ground.group), alike(ground))
        return fit_levels(
            plan.name, ground, sample=sample, skeleton=plan.skeleton, modelled=plan.modelled, words=plan.words
        )
    return fit_motion(
        plan.name,
        ground,
        flowing=plan.flowing,
        skeleton=plan.skeleton,
        modelled=plan.modelled,
        words=plan.words,
        kinds=plan.kinds,
        budget=budget,
    )
