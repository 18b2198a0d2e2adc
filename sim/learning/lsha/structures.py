"""Which structure the plant has: memories and merge tolerances, judged by the segments of held-out traces.

For every hypothesis the structure is learned again without each part of the traces, and the segments of that part are
held against the locations to which their words lead. An error counts in units of what it could be: the segment's own
standard error and the common scatter, the same for all hypotheses.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.learning import LEAST, HeldOutErrors, Indices, LearningError, choose
from sim.learning.lsha.evidence import SegmentSample
from sim.learning.lsha.flow_hypotheses import DELTA, Rival, merged, row
from sim.learning.lsha.merging import Partition
from sim.learning.lsha.settings import DELTAS, MEMORIES, LshaSettings, Memory
from sim.learning.lsha.teacher import Teacher
from sim.learning.lsha.words import MOST_EVENTS, Classes, classes_of
from sim.sha import Array, Mask


@dataclass(frozen=True, slots=True)
class Structure:
    """The chosen structure: classes of words by one memory, merged with one tolerance (a share of the spread)."""

    classes: Classes
    partition: Partition
    delta: float


def choose_structure(
    teacher: Teacher, sample: SegmentSample, settings: LshaSettings
) -> tuple[Structure, tuple[Rival, ...]]:
    """Memory first, then tolerance: each time the simplest structure that held-out segments do not tell from the best.

    With too few data to hold any out: the memory `context` and the tolerance DELTA.
    """
    memories = _memories(teacher, settings)
    deltas = DELTAS if settings.delta is None else (settings.delta,)
    first = DELTA if settings.delta is None else settings.delta
    tried = {(memory, first): _tried(teacher, sample, settings, memory, first) for memory in memories}
    memory = _best(tried)[0]
    rest = [(memory, delta) for delta in deltas if delta != first]
    finer = {(memory, first): tried[memory, first]} | {
        (memory, delta): _tried(teacher, sample, settings, memory, delta) for memory, delta in rest
    }
    best = _best(finer)
    table = tuple(
        replace(row(f"memory {one[0]}, delta {one[1]:g}", found.partition.laws, found.held), chosen=one == best)
        for one, found in (tried | finer).items()
    )
    chosen = finer[best]
    return Structure(chosen.classes, chosen.partition, best[1]), table


def _memories(teacher: Teacher, settings: LshaSettings) -> tuple[Memory, ...]:
    """The memories to be tried. Raises LearningError when `word` is asked for and there are too many words."""
    if settings.memory == "word" and not teacher.words.whole:
        raise LearningError(
            f"the memory 'word' tells all words apart, which is done for up to {MOST_EVENTS} events in all; the traces "
            "have more: choose another memory, or fewer traces"
        )
    if settings.memory is not None:
        return (settings.memory,)
    return tuple(one for one in MEMORIES if one != "word" or teacher.words.whole)


Hypothesis = tuple[Memory, float]


@dataclass(frozen=True, slots=True)
class _Tried:
    """One hypothesis: its structure on all data, and its held-out errors."""

    classes: Classes
    partition: Partition
    held: HeldOutErrors | None


def _tried(teacher: Teacher, sample: SegmentSample, settings: LshaSettings, memory: Memory, delta: float) -> _Tried:
    classes = classes_of(teacher.words, memory)
    partition = _learned(teacher, classes, sample, settings, delta)
    return _Tried(classes, partition, _held_out(teacher, classes, sample, settings, delta))


def _best(tried: Mapping[Hypothesis, _Tried]) -> Hypothesis:
    """The hypothesis that the held-out segments choose; without them the first one.

    The fewest locations count as the simplest, and among equals the memory that remembers least.
    """
    order = list(tried)
    known = [one.held for one in tried.values() if one.held is not None]
    if len(known) < len(order):
        return order[0]
    size = [one.partition.laws * len(MEMORIES) + MEMORIES.index(memory) for (memory, _), one in tried.items()]
    return order[choose(known, size)]


def _learned(
    teacher: Teacher, classes: Classes, sample: SegmentSample, settings: LshaSettings, delta: float
) -> Partition:
    return merged(classes, sample, teacher, delta=delta * sample.spread, alpha=settings.alpha, n_min=settings.n_min)


def _held_out(
    teacher: Teacher, classes: Classes, sample: SegmentSample, settings: LshaSettings, delta: float
) -> HeldOutErrors | None:
    """The errors of all segments, each against a structure that was learned without its part of the traces."""
    groups, order = np.unique(sample.segments.group, return_inverse=True)
    if groups.size < 2 or sample.value.size < LEAST:
        return None
    part = order % settings.split
    classed = classes.of_state[sample.segments.place]
    error = np.empty(sample.value.size)
    for held in np.unique(part):
        use = part != held
        partition = merged(
            classes, sample, teacher, delta=delta * sample.spread, alpha=settings.alpha, n_min=settings.n_min, use=use
        )
        means = _means(sample, partition.location[classes.of_state], partition.size, use)
        error[~use] = sample.value[~use] - means[partition.location[classed[~use]]]
    scale = np.sqrt(sample.scatter**2 + sample.segments.variance)
    return HeldOutErrors(error / scale, order)


def _means(sample: SegmentSample, place: Indices, size: int, use: Mask) -> Array:
    """(L,) the mean of each location, relative to the sample's centre; without evidence that of all."""
    pooled = sample.pooled(place, size, 2, use)
    return np.array([one.mean if one.count else 0.0 for one in pooled])
