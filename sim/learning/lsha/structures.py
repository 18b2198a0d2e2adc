"""Which structure the plant has: memories and merge tolerances, judged by the segments of held-out traces.

For every hypothesis the structure is learned again without each part of the traces, and the segments of that part are
held against the locations to which their words lead. An error counts in units of what it could be: the segment's own
standard error and the common scatter, the same for all hypotheses.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.learning import LEAST, HeldOutErrors, LearningError, choose
from sim.learning.lsha.evidence import SegmentSample
from sim.learning.lsha.flow_hypotheses import DELTA, Rival, merged, row
from sim.learning.lsha.merging import Partition
from sim.learning.lsha.settings import DELTAS, MEMORIES, LshaSettings, Memory
from sim.learning.lsha.teacher import Teacher
from sim.learning.lsha.words import MOST_EVENTS, Classes, classes_of
from sim.sha import Mask


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
    if settings.memory == "word" and not teacher.words.whole:
        raise LearningError(
            f"the memory 'word' tells all words apart, which is done for up to {MOST_EVENTS} events in all; the traces "
            "have more: choose another memory, or fewer traces"
        )
    if settings.memory is not None:
        memories: tuple[Memory, ...] = (settings.memory,)
    else:
        memories = tuple(memory for memory in MEMORIES if memory != "word" or teacher.words.whole)
    deltas = DELTAS if settings.delta is None else (settings.delta,)
    first = DELTA if settings.delta is None else settings.delta
    # One after the other, not the whole grid: seven structures are learned and held out instead of sixteen.
    coarser = {(memory, first): _tried(teacher, sample, settings, memory, first) for memory in memories}
    memory = _best(coarser)[0]
    finer = {(memory, first): coarser[memory, first]} | {
        (memory, delta): _tried(teacher, sample, settings, memory, delta) for delta in deltas if delta != first
    }
    best = _best(finer)
    table = tuple(
        replace(row(f"memory {key[0]}, delta {key[1]:g}", tried.partition.laws, tried.held), chosen=key == best)
        for key, tried in (coarser | finer).items()
    )
    chosen = finer[best]
    return Structure(chosen.classes, chosen.partition, best[1]), table


Hypothesis = tuple[Memory, float]


@dataclass(frozen=True, slots=True)
class _Tried:
    """One hypothesis: its structure on all data, and its held-out errors."""

    classes: Classes
    partition: Partition
    held: HeldOutErrors | None


def _tried(teacher: Teacher, sample: SegmentSample, settings: LshaSettings, memory: Memory, delta: float) -> _Tried:
    """The structure learned from all segments, and again without each part of the traces, which then judges it."""
    classes = classes_of(teacher.words, memory)

    def learned(use: Mask | None = None) -> Partition:
        return merged(
            classes, sample, teacher, delta=delta * sample.spread, alpha=settings.alpha, n_min=settings.n_min, use=use
        )

    partition = learned()
    groups, order = np.unique(sample.segments.group, return_inverse=True)
    if groups.size < 2 or sample.value.size < LEAST:
        return _Tried(classes, partition, None)
    part = order % settings.split
    classed = classes.of_state[sample.segments.place]
    error = np.empty(sample.value.size)
    for held in np.unique(part):
        use = part != held
        fewer = learned(use)
        # The mean of each location by the other parts, relative to the sample's centre; without evidence that of all.
        pooled = sample.pooled(fewer.location[classes.of_state], fewer.size, 2, use)
        means = np.array([each.mean if each.count else 0.0 for each in pooled])
        error[~use] = sample.value[~use] - means[fewer.location[classed[~use]]]
    scale = np.sqrt(sample.scatter**2 + sample.segments.variance)
    return _Tried(classes, partition, HeldOutErrors(error / scale, order))


def _best(tried: Mapping[Hypothesis, _Tried]) -> Hypothesis:
    """The hypothesis that the held-out segments choose; without them the first one.

    The fewest locations count as the simplest, and among equals the memory that remembers least.
    """
    order = list(tried)
    known = [each.held for each in tried.values() if each.held is not None]
    if len(known) < len(order):
        return order[0]
    size = [each.partition.laws * len(MEMORIES) + MEMORIES.index(memory) for (memory, _), each in tried.items()]
    return order[choose(known, size)]
