"""Where the plant may go when the events to come are not known: paths of a semi-Markov process over the locations.

A stay lasts as its location's sojourn law says, the present one given how long it has lasted already; then the next
location is drawn by `Stay.to`. All runs move together, a jump at a time, each on its own clock.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.sha.automaton import Distribution
from sim.sha.distributions import check_distribution, draw_each, draw_residual
from sim.sha.kinds import Indices, OfKind, by_kind
from sim.sha.model import Model
from sim.sha.trace import Array, Mask

MAX_STAYS = 1000
"""Stays of one run; a run that would need more stays where it is from then on, and is counted."""

_BLOCK = 32


@dataclass(frozen=True, slots=True)
class Chain:
    """The semi-Markov process of a model's L locations, in the automaton's order.

    `laws` are the sojourn laws (None: never left), `of_kind` the same by kind and `left` (L,) where there is one.
    `targets` (L, K) are the locations that may come next, in the automaton's order, and `cumulative` (L, K) their
    cumulated probabilities: inf from the last on.
    """

    names: tuple[str, ...]
    laws: tuple[Distribution | None, ...]
    of_kind: tuple[OfKind, ...]
    left: Mask
    targets: Indices
    cumulative: Array

    def next_locations(self, location: Indices, u: Array) -> Indices:
        """Where runs go on to from `location` (n,), by the uniform numbers `u` (n,)."""
        passed = (u[:, None] >= self.cumulative[location]).sum(axis=1)
        return np.asarray(self.targets[location, passed])


@dataclass(frozen=True, slots=True)
class Paths:
    """J stays of N runs: `location` (J, N) indices; `entered` (J, N) seconds from now, inf beyond the horizon.

    `entered[0]` is 0: the present stay, which is `age` seconds old, all runs' or each one's (N,). `cut` counts the runs
    that ran out of stays.
    """

    location: Indices
    entered: Array
    age: Array | float
    cut: int = 0


def compile_chain(model: Model) -> Chain:
    """The process of `model.semi_markov`. A location without a stay there (or whose stay leads nowhere) is never left.

    Raises ValueError, naming the location, for an unusable law, probabilities that are negative or do not sum to 1, and
    unknown names.
    """
    names = tuple(location.name for location in model.sha.locations)
    unknown = sorted(set(model.semi_markov) - set(names))
    if unknown:
        raise ValueError(f"model {model.sha.name!r}: the stay of {unknown[0]!r} belongs to no location")
    place = {name: number for number, name in enumerate(names)}
    laws: list[Distribution | None] = []
    moves: list[tuple[list[int], Array]] = []
    for number, name in enumerate(names):
        stay = model.semi_markov.get(name)
        if stay is None or not stay.to:
            laws.append(None)
            moves.append(([number], np.ones(1)))
            continue
        laws.append(stay.law)
        check_distribution(stay.law)
        strange = sorted(set(stay.to) - place.keys())
        if strange:
            raise ValueError(f"the stay of location {name!r} leads to {strange[0]!r}, which is not a location")
        ahead = sorted(stay.to, key=lambda other: place[other])
        chances = np.array([stay.to[other] for other in ahead])
        if not np.all(chances >= 0):
            wrong = ahead[int(np.argmin(chances >= 0))]
            raise ValueError(
                f"location {name!r}: the probability of the next location {wrong!r} is {stay.to[wrong]:g}; it must be "
                "at least 0"
            )
        if not abs(float(chances.sum()) - 1.0) < 1e-6:
            raise ValueError(f"location {name!r}: the probabilities of the next location sum to {chances.sum()}, not 1")
        moves.append(([place[other] for other in ahead], np.cumsum(chances / chances.sum())))
    most = max(len(into) for into, _ in moves)
    targets, cumulative = np.zeros((len(names), most), dtype=np.intp), np.full((len(names), most), np.inf)
    for number, (into, sums) in enumerate(moves):
        targets[number, : len(into)] = into
        # The last has no end: a sum of probabilities may end just below 1, and a number drawn above it lead nowhere.
        cumulative[number, : len(into) - 1] = sums[:-1]
    return Chain(names, tuple(laws), by_kind(laws), np.array([law is not None for law in laws]), targets, cumulative)


def draw_paths(
    chain: Chain, location: int, *, age: float, horizon: float, runs: int, rng: np.random.Generator
) -> Paths:
    """`runs` independent paths over `horizon` seconds from `location`, in which `age` seconds have passed."""
    law = chain.laws[location]
    left = np.full(runs, np.inf) if law is None else draw_residual(law, age, runs, rng)
    places: list[Indices] = [np.full((1, runs), location, dtype=np.intp)]
    clocks = [np.zeros((1, runs))]
    count = 1
    # Stays are drawn in blocks, because a jump of all runs costs the same whether few of them need it or all: first
    # where the next _BLOCK jumps of the embedded chain lead, then how long each stay lasts.
    while count < MAX_STAYS and np.any(left < horizon):
        current, u = places[-1][-1], rng.random((_BLOCK, runs))
        block = np.empty(u.shape, dtype=np.intp)
        for row in range(_BLOCK):
            block[row] = current = chain.next_locations(current, u[row])
        # The order of the draws, by location and run, is part of a seed's forecast.
        flat, lasts = block.ravel(), np.full(block.size, np.inf)
        order = np.argsort(flat, kind="stable")
        order = order[chain.left[flat[order]]]
        lasts[order] = draw_each(chain.of_kind, flat[order], rng)
        begins = left + np.cumsum(np.vstack([np.zeros(runs), lasts.reshape(block.shape)]), axis=0)
        places.append(block)
        clocks.append(begins[:-1])
        left = begins[-1]
        count += _BLOCK
    entered = np.concatenate(clocks)
    entered[entered >= horizon] = np.inf
    needed = int((entered < np.inf).sum(axis=0).max())
    return Paths(np.concatenate(places)[:needed], entered[:needed], age, int((left < horizon).sum()))


def known_paths(stays: Sequence[tuple[float, int]], age: float, runs: int) -> Paths:
    """The same given path for all runs: (seconds from now, location index) of each stay, the present one first at 0."""
    entered = np.array([begin for begin, _ in stays])
    location = np.array([index for _, index in stays], dtype=np.intp)
    shape = (len(stays), runs)
    return Paths(np.broadcast_to(location[:, None], shape), np.broadcast_to(entered[:, None], shape), age)


def input_moments(model: Model, held: Mapping[str, float]) -> Array:
    """(L, 2) mean and standard deviation of what a future stay's inputs add to its target (degC).

    A signal varies from stay to stay as `Stay.inputs` says; one that is not there stays at its `held` value, or at its
    reference when it was never read.
    """
    moments = np.zeros((len(model.sha.locations), 2))
    for row, location in enumerate(model.sha.locations):
        stay = model.semi_markov.get(location.name)
        learned = stay.inputs if stay is not None else {}
        for driver in location.flow.inputs:
            mean, sigma = learned.get(driver.signal, (held.get(driver.signal, driver.reference), 0.0))
            moments[row, 0] += driver.gain * (mean - driver.reference)
            moments[row, 1] += (driver.gain * sigma) ** 2
    moments[:, 1] = np.sqrt(moments[:, 1])
    return moments
