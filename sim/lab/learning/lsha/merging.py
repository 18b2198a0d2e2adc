"""Which words lead to the same location: rows of the observation table compared, merged, or kept apart.

Every class of words is a row. Rows are taken in the order of their evidence; each is compared with the locations known
so far by hypothesis-test queries (closedness: a row that equals none of them becomes a location). A merge is only made
together with all that it entails: if two words are one, so are their extensions by every observed symbol (consistency),
and so on along all suffixes. Each pair of rows that meets on the way is tested as well. A cell without evidence decides
nothing by itself, so equality is transitive and the automaton is deterministic, always.

The error rate: K classes have `n_min` segments or more. Each merge is tested at alpha / K, its p being the smallest of
the pairs that it entails times their number (Bonferroni). So the probability that any class is kept apart from the
location to which it belongs is at most alpha (family-wise), as far as the tests' normal approximation holds.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Literal, NamedTuple

import numpy as np

from sim.lab.learning import Indices
from sim.lab.learning.lsha.evidence import PooledEvidence, WelchTest, same_distribution
from sim.lab.learning.lsha.words import Classes, switch_positions
from sim.sha import Mask

MAX_MERGE_TRIALS = 6
"""Locations with which a merge is tried, the best first, before a row becomes a location of its own."""

Verdict = Literal["new", "merged", "default", "dissolved"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """Why class `row` is where it is. `other` is the class that its location began with (itself for a new one).

    `new`: no location equals it, `answer` is that of the most similar one, which is `rival`; `suffix` is the word by
    which that one was told apart, empty for the row's own segments. `merged`: the best location that nothing speaks
    against. `default`: below `n_min`, the default hypothesis, not refuted. `dissolved`: a location below `n_min` whose
    segments in the end did not speak against another one.
    """

    row: int
    verdict: Verdict
    other: int
    evidence: int
    answer: WelchTest | None = None
    rival: int | None = None
    suffix: tuple[str, ...] = ()


Suffix = tuple["Suffix", str] | None
"""A word from its end: what comes before the last symbol, and that symbol; None is the empty one. A long word shares
its beginning with all that go on from it."""


def _spell_suffix(suffix: Suffix) -> tuple[str, ...]:
    symbols: list[str] = []
    while suffix is not None:
        suffix, symbol = suffix
        symbols.append(symbol)
    return tuple(reversed(symbols))


class Query(NamedTuple):
    """Two classes that a merge would make one, and the suffix on which they meet; None: they cannot be one at all."""

    answer: WelchTest | None
    suffix: Suffix
    pair: tuple[int, int]

    @property
    def p(self) -> float:
        """The probability of so different evidence in one location; 0 where they cannot be one."""
        return self.answer.p if self.answer else 0.0


class TooManyQueriesError(Exception):
    """The words do not fall into few locations, so they are not told apart one by one."""


@dataclass(frozen=True, slots=True)
class Partition:
    """The result: `location` (C,) of each class, numbered from 0 in the classes' order; how it came about.

    `modelled` (L,) says which locations have evidence; `queries` counts the hypothesis-test queries, `level` is the p
    below which one told two rows apart.
    """

    location: Indices
    modelled: Sequence[bool]
    decisions: tuple[Decision, ...]
    queries: int
    level: float

    @property
    def size(self) -> int:
        """How many locations there are."""
        return len(self.modelled)

    @property
    def laws(self) -> int:
        """How many locations have a law of their own."""
        return sum(self.modelled)


@dataclass(slots=True, kw_only=True)
class _PartitionState:
    """The partition while it is made: union-find over classes, edges and evidence of each set; the rows done (C,)."""

    parent: list[int]
    edges: list[dict[str, int]]
    evidence: list[PooledEvidence]
    fixed: set[int]
    switches: Sequence[tuple[int | None, ...]]
    """(C,) where the switches stand after each class; all classes of a set have the same."""
    placed: list[bool]
    delta: float
    n_min: int
    most: float = inf
    queries: int = 0
    known: dict[int, None] = field(default_factory=dict)
    """The locations, in the order in which they became ones."""

    def find(self, number: int) -> int:
        while self.parent[number] != number:
            self.parent[number] = self.parent[self.parent[number]]
            number = self.parent[number]
        return number

    def candidates(self, row: int) -> list[int]:
        """The locations with which a row may be one: what such a merge entails keeps the switches alike as well."""
        return [location for location in self.known if self.switches[location] == self.switches[row]]

    def compare(self, first: PooledEvidence, second: PooledEvidence) -> WelchTest:
        self.queries += 1
        if self.queries > self.most:
            raise TooManyQueriesError
        return same_distribution(first, second, self.delta)


@dataclass(slots=True)
class _Fold:
    """A merge on trial: what would be joined, over the state as it is."""

    state: _PartitionState
    parent: dict[int, int] = field(default_factory=dict)
    edges: dict[int, dict[str, int]] = field(default_factory=dict)
    evidence: dict[int, PooledEvidence] = field(default_factory=dict)
    answers: list[Query] = field(default_factory=list)

    def find(self, number: int) -> int:
        number, parent = self.state.find(number), self.parent
        while number in parent:
            number = parent[number]
        return number

    def join(self, row: int, location: int, level: float = 0.0) -> Query | None:
        """Joins two sets with all that it entails; what speaks against it outright, if anything does.

        A pair whose p stays below `level` even after the correction for as many tests as there can be at all ends it
        at once: most merges are wrong, and the first few pairs show it.
        """
        # Most of the learning's time is spent here: what a round looks up is at hand.
        state, parent, known, fixed, find = self.state, self.parent, self.state.known, self.state.fixed, self.find
        certain = level / len(state.parent)
        # The shortest suffixes first: their words have most evidence.
        pairs: deque[tuple[int, int, Suffix]] = deque([(location, row, None)])
        while pairs:
            first, second, suffix = pairs.popleft()
            keep, absorbed = find(first), find(second)
            if keep == absorbed:
                continue
            if absorbed in known and keep not in known:
                keep, absorbed = absorbed, keep  # a known location keeps its number
            if absorbed in fixed or keep in fixed:
                return Query(None, suffix, (keep, absorbed))
            kept_evidence = self.evidence.get(keep) or state.evidence[keep]
            absorbed_evidence = self.evidence.get(absorbed) or state.evidence[absorbed]
            if kept_evidence.sums[0] and absorbed_evidence.sums[0]:
                query = Query(state.compare(kept_evidence, absorbed_evidence), suffix, (keep, absorbed))
                if query.p < certain:
                    return query
                self.answers.append(query)
            self.evidence[keep] = kept_evidence.merge(absorbed_evidence)
            # Consistency: where both sets have an edge on a symbol, determinism makes their targets one as well.
            kept, lost = self.edges.get(keep, state.edges[keep]), self.edges.get(absorbed, state.edges[absorbed])
            if shared := kept.keys() & lost.keys():
                pairs += [(kept[symbol], lost[symbol], (suffix, symbol)) for symbol in sorted(shared)]
            self.edges[keep] = {**lost, **kept}
            parent[absorbed] = keep
        return None

    def worst(self) -> tuple[float, Query | None]:
        """(p of the whole merge, the pair that speaks most against it)."""
        if not self.answers:
            return 1.0, None
        # Bonferroni: the least of n p-values is multiplied by n, whatever the dependence between the tests.
        least = min(self.answers, key=lambda query: query.p)
        p = least.p * len(self.answers)
        together = self._together()
        if together:
            # Two families of tests share the error rate.
            most = min(together, key=lambda query: query.p)
            p, least = min((2.0 * p, least), (2.0 * most.p * len(together), most), key=lambda each: each[0])
        return min(1.0, p), least

    def _together(self) -> list[Query]:
        """Each location against all that would join it, together: many words that say little by themselves."""
        found = []
        for keep, whole in self.evidence.items():
            own = self.state.evidence[keep]
            if keep in self.state.known and own.count and whole.count - own.count >= self.state.n_min:
                self.state.queries += 1
                rest = whole.subtract(own)
                found.append(Query(same_distribution(own, rest, self.state.delta), None, (keep, keep)))
        return found

    def commit(self) -> None:
        state = self.state
        for absorbed, keep in self.parent.items():
            state.parent[absorbed] = keep
            state.known.pop(absorbed, None)
        for number, edges in self.edges.items():
            state.edges[number] = edges
        for number, evidence in self.evidence.items():
            state.evidence[number] = evidence


def learn_partition(
    classes: Classes,
    evidence: Sequence[PooledEvidence],
    modelled: Mask,
    *,
    delta: float,
    alpha: float,
    n_min: int,
    most: float = inf,
) -> Partition:
    """The classes merged into locations; `delta` in the parameter's unit. The result depends on the evidence alone.

    Classes that are not `modelled` (C,), in which a channel is not known, stay what they are: nothing is merged with
    them, so that not knowing never becomes knowing; nor are classes after which a switch stands differently merged.
    Raises TooManyQueriesError after the `most` queries.
    """
    size = len(classes)
    fixed = {number for number in range(size) if not modelled[number]}
    edges = [dict(each) for each in classes.edges]
    state = _PartitionState(
        parent=list(range(size)),
        edges=edges,
        evidence=list(evidence),
        fixed=fixed,
        switches=switch_positions(classes.keys, classes.meaning),
        placed=[False] * size,
        delta=delta,
        n_min=n_min,
        most=most,
    )
    # Only classes with evidence can be told apart by chance; the others do not share in the error rate.
    level = alpha / max(sum(pooled.count > 0 for pooled in evidence), 1)
    free = [number for number in range(size) if number not in fixed]
    if classes.memory == "word":
        # By their length, as the tree of words numbers them: a single word has little evidence, and the merges of short
        # words decide where longer ones belong.
        order = sorted(free, key=lambda n: classes.keys[n].word)
    else:
        order = sorted(free, key=lambda n: (-evidence[n].count, n))
    decisions: list[Decision] = []
    # Closedness: every row equals a location or becomes one. The order matters: what has most evidence becomes a
    # location first, so that a row of chance does not attract the rows to which it happens to be like.
    for row in order:
        # A merge before may have entailed where the row belongs.
        if state.find(row) not in state.known:
            if state.evidence[state.find(row)].count:
                decisions.append(_decide(state, row, classes, level))
            else:
                # Without any evidence it follows the default hypothesis, where determinism and the tests allow it.
                for neighbour in _neighbours(state, row, classes):
                    fold = _Fold(state)
                    if fold.join(state.find(row), neighbour, level) is None and fold.worst()[0] >= level:
                        fold.commit()
                        decisions.append(Decision(row=row, verdict="default", other=neighbour, evidence=0))
                        break
        state.placed[row] = True
    decisions += _dissolve_small(state, level)
    # Locations are numbered in the order of their first class, whatever number their set has.
    roots = [state.find(number) for number in range(size)]
    numbers: dict[int, int] = {}
    for root in roots:
        numbers.setdefault(root, len(numbers))
    return Partition(
        location=np.array([numbers[root] for root in roots], dtype=np.intp),
        modelled=tuple(root in state.known for root in numbers),
        decisions=tuple(decisions),
        queries=state.queries,
        level=level,
    )


def _decide(state: _PartitionState, row: int, classes: Classes, level: float) -> Decision:
    """A row with evidence joins the location that nothing speaks against, or becomes one."""
    root = state.find(row)
    evidence = state.evidence[root]
    # The row's own segments against those of every location, the most similar first.
    answers = {location: state.compare(state.evidence[location], evidence) for location in state.candidates(root)}
    equal = sorted(
        (location for location, answer in answers.items() if answer.p >= level),
        key=lambda location: (-answers[location].p, location),
    )
    default = _default(state, root, classes)
    if default in equal:
        equal.remove(default)
        equal.insert(0, default)
    # Each merge is tried with all that it entails, on a copy: a suffix may tell apart what the row itself does not.
    refused: Query | None = None
    allowed: list[tuple[int, _Fold]] = []
    for location in equal[:MAX_MERGE_TRIALS]:
        fold = _Fold(state)
        query = fold.join(root, location, level)
        p, against = fold.worst()
        if query is None and p >= level:
            allowed.append((location, fold))
            if classes.memory != "word":
                break
        else:
            refused = refused or query or against
    count = int(evidence.count)
    if allowed:
        # A single word says little by itself: of several merges the one for which most of what follows was compared.
        location, fold = max(allowed, key=lambda candidate: len(candidate[1].answers))
        fold.commit()
        verdict: Verdict = "default" if location == default and evidence.count < state.n_min else "merged"
        return Decision(row=row, verdict=verdict, other=location, evidence=count, answer=answers[location])
    state.known[root] = None
    if refused is not None:
        answer, rival, suffix = refused.answer, equal[0], _spell_suffix(refused.suffix)
        return Decision(row=row, verdict="new", other=root, evidence=count, answer=answer, rival=rival, suffix=suffix)
    nearest = max(answers, key=lambda location: answers[location].p, default=None)
    test = answers[nearest] if nearest is not None else None
    return Decision(row=row, verdict="new", other=root, evidence=count, answer=test, rival=nearest)


def _default(state: _PartitionState, row: int, classes: Classes) -> int | None:
    """The default hypothesis: the location that began with the same context, or, below `n_min`, the nearest one."""
    if state.evidence[row].count < state.n_min:
        return next(iter(_neighbours(state, row, classes)), None)
    key = classes.keys[row]
    same = [location for location in state.candidates(row) if classes.keys[location].context == key.context]
    return min(same, key=lambda number: (classes.keys[number].direction != key.direction, number), default=None)


def _neighbours(state: _PartitionState, row: int, classes: Classes) -> list[int]:
    """The locations by how near the nearest words are that lead there, MAX_MERGE_TRIALS at most."""
    near: dict[int, None] = {}
    for other in classes.nearest_classes(row):
        if state.placed[other] and state.switches[other] == state.switches[row]:
            near.setdefault(state.find(other))
            if len(near) == MAX_MERGE_TRIALS:
                break
    return [location for location in near if location in state.known]


def _dissolve_small(state: _PartitionState, level: float) -> list[Decision]:
    """Locations below `n_min` join the most likely location that neither their own segments nor the tests of the rest
    speak against, if there is one."""
    decisions: list[Decision] = []
    # The smallest first; a list of its own, because a merge takes locations out of `known`.
    for location in sorted(state.known, key=lambda n: (state.evidence[n].count, n)):
        evidence = state.evidence[location]
        if location not in state.known or evidence.count >= state.n_min:
            continue
        # What became a location because of a few segments may be one of chance: they are asked once more, this time
        # without the certainty that they scatter as all do. How many they are does not matter if they still say no.
        answers = {
            other: state.compare(state.evidence[other], evidence.cautious)
            for other in state.candidates(location)
            if other != location and state.evidence[other].count >= state.n_min
        }
        allowed = (other for other, answer in answers.items() if answer.p >= level)
        for other in sorted(allowed, key=lambda n: (-answers[n].p, n))[:MAX_MERGE_TRIALS]:
            fold = _Fold(state)
            if fold.join(location, other) is not None:
                continue
            rest = [query.p for query in fold.answers if query.suffix]
            if not rest or min(rest) * len(rest) >= level:
                fold.commit()
                decisions.append(
                    Decision(
                        row=location,
                        verdict="dissolved",
                        other=other,
                        evidence=int(evidence.count),
                        answer=answers[other],
                    )
                )
                break
    return decisions
