"""Which structure the plant has: memories and merge tolerances, judged by the segments of held-out traces.

For every hypothesis the structure is learned again without each part of the traces, and the segments of that part are
held against the locations to which their words lead. An error counts in units of what it could be: the segment's own
standard error and the common scatter, the same for all hypotheses.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim.lab.learning import MIN_READINGS, HeldOutErrors, choose
from sim.lab.learning.lsha.evidence import SegmentSample
from sim.lab.learning.lsha.flow_hypotheses import (
    COARSE_MERGE_TOLERANCE,
    Contender,
    held_out_parts,
    merge_classes,
    row,
    why_not_word_by_word,
)
from sim.lab.learning.lsha.merging import Partition, TooManyQueriesError
from sim.lab.learning.lsha.settings import DELTAS, MEMORIES, LshaSettings, Memory
from sim.lab.learning.lsha.teacher import Teacher
from sim.lab.learning.lsha.words import Classes, build_classes
from sim.sha import Mask

Hypothesis = tuple[Memory, float]


@dataclass(frozen=True, slots=True)
class Structure:
    """The chosen structure: classes of words by one memory, merged with one tolerance (a share of the spread)."""

    classes: Classes
    partition: Partition
    delta: float


def choose_structure(
    teacher: Teacher, sample: SegmentSample, settings: LshaSettings
) -> tuple[Structure, tuple[Contender, ...]]:
    """Memory first, then tolerance: each time the simplest structure that held-out segments do not tell from the best.

    With too few data to hold any out: the memory `context` and the tolerance COARSE_MERGE_TOLERANCE. What was not tried
    to the end is in the table, with the reason.
    """
    memories = MEMORIES if settings.memory is None else (settings.memory,)
    deltas = DELTAS if settings.delta is None else (settings.delta,)
    first = COARSE_MERGE_TOLERANCE if settings.delta is None else settings.delta
    tried: dict[Hypothesis, _Tried] = {}
    given_up: dict[Hypothesis, str] = {}

    def attempt(memory: Memory, delta: float) -> None:
        why = why_not_word_by_word(teacher, sample) if memory == "word" and settings.memory is None else ""
        if not why:
            try:
                tried[memory, delta] = _try_structure(teacher, sample, settings, memory, delta)
            except TooManyQueriesError:
                why = "given up: single words do not fall into few locations"
        if why:
            given_up[memory, delta] = why

    # One after the other, not the whole grid: seven structures are learned and held out instead of sixteen.
    for each in memories:
        attempt(each, first)
    memory = _best(tried)[0]
    for delta in deltas:
        if delta != first:
            attempt(memory, delta)
    best = _best({key: found for key, found in tried.items() if key[0] == memory})
    table = [
        replace(row(_label(key), found.partition.laws, found.held), chosen=key == best) for key, found in tried.items()
    ]
    table += [replace(row(_label(key), 0, None), note=why) for key, why in given_up.items()]
    return Structure(tried[best].classes, tried[best].partition, best[1]), tuple(table)


def _label(hypothesis: Hypothesis) -> str:
    return f"memory {hypothesis[0]}, delta {hypothesis[1]:g}"


@dataclass(frozen=True, slots=True)
class _Tried:
    """One hypothesis: its structure on all data, and its held-out errors."""

    classes: Classes
    partition: Partition
    held: HeldOutErrors | None


def _try_structure(
    teacher: Teacher, sample: SegmentSample, settings: LshaSettings, memory: Memory, delta: float
) -> _Tried:
    """The structure learned from all segments, and again without each part of the traces, which then judges it."""
    classes = build_classes(teacher.words, memory)

    def learn_partition(use: Mask | None = None) -> Partition:
        return merge_classes(
            classes,
            sample,
            teacher,
            delta=delta * sample.spread,
            alpha=settings.alpha,
            n_min=settings.n_min,
            use=use,
            patient=settings.memory is not None,
        )

    partition = learn_partition()
    groups, order = np.unique(sample.segments.group, return_inverse=True)
    if groups.size < 2 or sample.value.size < MIN_READINGS:
        return _Tried(classes, partition, None)
    part = order % held_out_parts(teacher, groups.size, settings.split)
    classed = classes.of_state[sample.segments.place]
    error = np.empty(sample.value.size)
    for held in np.unique(part):
        use = part != held
        fewer = learn_partition(use)
        # The mean of each location by the other parts, relative to the sample's centre; without evidence that of all.
        pooled = sample.pool_classes(fewer.location[classes.of_state], fewer.size, 2, use)
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
