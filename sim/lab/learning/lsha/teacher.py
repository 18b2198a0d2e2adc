"""The traces made ready for the learner: one walk through the finest automaton, free runs, and who is held out when."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim.lab.learning import (
    MIN_READING_SHARE,
    MIN_TRAINING_READINGS,
    FreeRuns,
    Indices,
    LearningError,
    Prior,
    first_switch,
    free_runs,
    level_signals,
    pieces,
    trace_machines,
)
from sim.lab.learning.lsha.words import TraceWords, build_classes, build_words
from sim.sha import Alphabet, Array, Mask, Trace

MIN_RUN_S = 3600.0
"""Seconds that a free run lasts at least before the next start-up begins a new one."""
MAX_COMMON_MOVES = 4
"""Moves that words have in common at most for their segments to count as alike."""
TARGET_SPREAD_DEGC = 40.0
"""Spread of the prior of targets, in degC, and what an input moves a target by over one standard deviation of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Teacher:
    """What every hypothesis is built on.

    `runs` have a place in the finest automaton (`words`); `modelled` (S,) says which of its states may have a law of
    their own. `group` (n,) is the part of the data that a knot is held out with: a trace, or a part of one where there
    are fewer traces than `split`. `signals` are the inputs of the runs, `centre` (q,) their means over time. `alike`
    (each (S,)) are classes of states that are believed to resemble each other, the finest first. `machines` (T,) are
    the traces' machines, by the numbers that the runs give them.
    """

    words: TraceWords
    runs: FreeRuns
    modelled: Mask
    group: Indices
    signals: tuple[str, ...]
    centre: Array
    prior: Prior
    alike: tuple[Indices, ...]
    machines: tuple[str, ...]

    @property
    def alphabet(self) -> Alphabet:
        """The alphabet of the words."""
        return self.words.meaning.alphabet


def make_teacher(traces: Sequence[Trace], alphabet: Alphabet, temperature: str, n_min: int, split: int) -> Teacher:
    """The encoded traces as words and free runs. Raises LearningError when they leave nothing to fit."""
    words = build_words(traces, alphabet, n_min)
    signals, switch = level_signals(alphabet), first_switch(alphabet)
    rising = switch.rising if switch else None

    def follow_traces(modelled: Mask) -> FreeRuns:
        return free_runs(
            traces,
            words.sha,
            temperature,
            signals=signals,
            modelled=modelled,
            rising=rising,
            cycle=MIN_RUN_S,
            jumps=True,
        )

    contexts = [state.context for state in words.states]
    something = np.array([any(value is not None for value in context) for context in contexts])
    runs = follow_traces(something)
    # A law of their own: states in which every channel is known, and those of contexts that hold a tenth of the
    # readings all the same. It is seen only in the runs, so the runs are made anew where another state cuts them.
    readings = np.bincount(runs.place[np.isfinite(runs.reading) & ~runs.first], minlength=len(contexts))
    of_context = dict.fromkeys(contexts, 0)
    for context, count in zip(contexts, readings.tolist(), strict=True):
        of_context[context] += count
    enough = np.array(
        [None not in context or of_context[context] >= MIN_READING_SHARE * readings.sum() for context in contexts]
    )
    modelled = np.asarray(enough & something)
    if np.any(~modelled[np.unique(runs.place)]):
        runs = follow_traces(modelled)
    reading = runs.reading[np.isfinite(runs.reading)]
    if reading.size < MIN_TRAINING_READINGS or not runs.dt.sum() > 0:
        raise LearningError(
            f"only {reading.size} readings of {temperature!r} fall into known locations, over {runs.dt.sum():.0f} s; "
            f"a model needs at least {MIN_TRAINING_READINGS}, at different times"
        )
    centre, spread = _moments(runs)
    gains = {signal: TARGET_SPREAD_DEGC / s for signal, s in zip(signals, spread.tolist(), strict=True) if s > 0}
    prior = Prior((float(np.median(reading)), TARGET_SPREAD_DEGC), gains)
    return Teacher(
        words=words,
        runs=runs,
        modelled=modelled,
        # Whole traces are held out where there are enough of them; else halves of halves, two for each part.
        group=runs.trace if np.unique(runs.trace).size >= split else pieces(runs, 2 * split).run,
        signals=signals,
        centre=centre,
        prior=prior,
        alike=_similar_states(words),
        machines=trace_machines(traces, temperature),
    )


def beginnings(traces: Sequence[Trace], most: int, split: int) -> tuple[Trace, ...]:
    """A sample of the encoded traces with about `most` events in all; all of them if they have no more.

    Whole traces, spread evenly over all; where they are so long that fewer than `split` of them would be left, so many
    of their beginnings. A word begins where its trace does, so that a part of a trace is of use from its beginning on.
    """
    events = [len(trace.events) for trace in traces]
    if sum(events) <= most:
        return tuple(traces)
    count = min(max(most // max(events), split), len(traces))
    chosen = [traces[number] for number in np.linspace(0, len(traces) - 1, count).astype(int).tolist()]
    each = most // count
    # The event after the last one ends the last segment.
    return tuple(
        trace.between(trace.times[0], trace.events[each].time) if len(trace.events) > each else trace
        for trace in chosen
    )


def _moments(runs: FreeRuns) -> tuple[Array, Array]:
    """(means, standard deviations) of the inputs over time; 0 where one was never read."""
    known = np.isfinite(runs.inputs)
    weight = np.where(known, runs.dt[:, None], 0.0)
    mass = np.maximum(weight.sum(axis=0), 1e-300)
    values = np.nan_to_num(runs.inputs)
    mean = (weight * values).sum(axis=0) / mass
    return mean, np.sqrt((weight * (values - mean) ** 2).sum(axis=0) / mass)


def _similar_states(words: TraceWords) -> tuple[Indices, ...]:
    """The finest states joined ever more: as they are, then by their last MAX_COMMON_MOVES moves, ..., by their last
    one."""
    last = build_classes(words, "previous").of_state
    before = np.zeros(last.size, dtype=np.intp)
    for (source, _), (target, _) in words.edges.items():
        before[target] = source
    joined = [last]
    for _ in range(MAX_COMMON_MOVES - 1):
        # The last k + 1 moves are those k of the word before, and the last one.
        pair = joined[-1][before] * last.size + last
        joined.append(np.unique(pair, return_inverse=True)[1])
    return (np.arange(last.size), *reversed(joined))


def renumber_places(runs: FreeRuns, place: Indices) -> FreeRuns:
    """The runs with their places renumbered: `place` (S,) is the new place of each."""
    return replace(runs, place=place[runs.place])
