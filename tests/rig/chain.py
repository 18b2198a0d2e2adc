"""Probabilities of timed formulas over a continuous-time Markov chain, by matrix exponentials: no run, no product code.

A formula speaks of locations and of the time since the start. The chain is followed together with the property: what
is decided is taken out of it. Deadlines that begin anew with each cause are no chain; there the equation with a delay
is solved interval by interval (the method of steps), each of which is one matrix exponential more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import eq, ge, gt, le, lt, ne

import numpy as np
from scipy.linalg import block_diag, expm

from sim.lab.checking.query.tree import At, Both, Compare, Constant, Either, Formula, Not, Number
from sim.sha.trace import Array, Mask

COMPARED = {"<": lt, "<=": le, "==": eq, "!=": ne, ">=": ge, ">": gt}


@dataclass(frozen=True)
class MarkovChain:
    """Exponential stays of `means` (s); `to` (n, n) are the chances of the next location. Runs begin in the first."""

    names: tuple[str, ...]
    means: tuple[float, ...]
    to: Array

    @property
    def generator(self) -> Array:
        """(n, n) the rates (1/s), rows summing to 0."""
        rates = 1.0 / np.array(self.means)
        return np.asarray(rates[:, None] * (self.to - np.eye(len(self.names))))

    def prism(self) -> str:
        """The chain in the language of PRISM, as Storm reads it; the locations' names are labels."""
        moves = [
            f"<> s={i} -> "
            + " + ".join(f"{float(p) / self.means[i]!r} : (s'={j})" for j, p in enumerate(row) if p)
            + ";"
            for i, row in enumerate(self.to)
        ]
        labels = [f'label "{name}" = s={i};' for i, name in enumerate(self.names)]
        space = f"s : [0..{len(self.names) - 1}] init 0;"
        return "\n".join(["ctmc", "module chain", space, *moves, "endmodule", *labels])

    def mask(self, formula: Formula, time: float = 0.0) -> Mask:
        """(n,) where a formula over locations and `time` is true."""
        return np.array([_true(formula, name, time) for name in self.names])


def _true(formula: Formula, name: str, time: float) -> bool:
    match formula:
        case At(location=location):
            return name == location
        case Constant(value=value):
            return value
        case Not(inner=inner):
            return not _true(inner, name, time)
        case Both(left=left, right=right):
            return _true(left, name, time) and _true(right, name, time)
        case Either(left=left, right=right):
            return _true(left, name, time) or _true(right, name, time)
        case Compare(op=op, right=Number(value=value)):
            return bool(COMPARED[op](time, value))
    raise ValueError(f"{formula} is no formula over locations and time")


def _changes(formula: Formula) -> set[float]:
    """The times at which the formula's comparisons with `time` change."""
    if isinstance(formula, Compare) and isinstance(formula.right, Number):
        return {formula.right.value}
    parts = (getattr(formula, name, None) for name in ("inner", "left", "right"))
    return {time for part in parts if part is not None and not isinstance(formula, Compare) for time in _changes(part)}


def until(chain: MarkovChain, hold: Formula, goal: Formula, low: float, high: float) -> float:
    """The probability of `hold U[low,high] goal`."""
    n, success = len(chain.names), 0.0
    alive = np.eye(n)[0]
    times = sorted({0.0, low, high} | {time for time in _changes(hold) | _changes(goal) if 0.0 < time < high})
    for begin, end in zip(times, [*times[1:], None], strict=True):
        if low <= begin:
            at_goal = chain.mask(goal, begin)
            success += float(alive[at_goal].sum())
            alive = np.where(at_goal, 0.0, alive)
        alive = np.where(chain.mask(hold, begin), alive, 0.0)
        if end is None:
            break
        middle = 0.5 * (begin + end)
        kept, wanted = chain.mask(hold, middle), chain.mask(goal, middle) & (low <= begin)
        # A goal that is true right after `begin` counts only where hold is true there too.
        success += float(alive[kept & wanted].sum())
        live = kept & ~wanted
        alive = np.where(live, alive, 0.0)
        # One more state for the goal; what is left without it goes where nothing comes back from.
        rates = np.zeros((n + 1, n + 1))
        rates[:n, :n] = np.where(live[:, None] & live[None, :], chain.generator, 0.0)
        rates[:n, n] = np.where(live, chain.generator[:, wanted].sum(axis=1), 0.0)
        moved = np.append(alive, 0.0) @ expm(rates * (end - begin))
        alive, success = moved[:n], success + float(moved[n])
    return success


def response(
    chain: MarkovChain, cause: Formula, effect: Formula, within: float, last: float, first: float = 0.0
) -> float:
    """The probability that every cause of first..last (s) is followed by an effect within the time, from locations.

    With s seconds to go until `last`, v(s) is the probability where no cause waits and w(s) where one has just come:

        v' = A v + B w,    w(s) = the effect comes after `last` and in time, or u <= min(s, within) s from now, then v.

    The last part y obeys y' = D y + G v(s) - e^{D within} G v(s - within): D moves among locations without effect, G
    leads to one. Over each interval of length `within` v(s - within) is the solution of the one before.
    """
    q, done, caused = chain.generator, chain.mask(effect), chain.mask(cause)
    free, owing, waits = done | ~caused, ~done, caused & ~done
    nf, no = int(free.sum()), int(owing.sum())
    a, d = q[np.ix_(free, free)], q[np.ix_(owing, owing)]
    b = np.zeros((nf, no))  # from where nothing waits to a new cause, as columns of the locations that owe an effect
    b[:, waits[owing]] = q[np.ix_(free, waits)]
    g = np.zeros((no, nf))  # to an effect, as columns of the locations where nothing waits
    g[:, done[free]] = q[np.ix_(owing, done)]
    missed = expm(d * within)

    count = int(last // within)
    size = nf + no
    own = np.block([[a, b], [g, d]])
    delayed = np.block([[np.zeros((nf, nf)), np.zeros((nf, no))], [-missed @ g, np.zeros((no, no))]])
    # The first interval has z = e^{D s} 1 and a constant besides: w = y + z - missed 1 there, w = y afterwards.
    whole = block_diag(*[own] * (count + 1), d, np.zeros((1, 1)))
    late, one = size * (count + 1), size * (count + 1) + no
    whole[:nf, late:one] = b
    whole[:nf, one] = -b @ missed @ np.ones(no)
    for k in range(1, count + 1):
        whole[k * size : (k + 1) * size, (k - 1) * size : k * size] = delayed
    state = np.zeros(whole.shape[0])
    state[:nf], state[late:] = 1.0, 1.0
    for k in range(count):  # what interval k ends with, k + 1 begins with; those after it do not matter yet
        ended = expm(whole * within) @ state
        state[(k + 1) * size : (k + 2) * size] = ended[k * size : (k + 1) * size]
    state = expm(whole * (last - count * within)) @ state
    v, w = np.split(state[count * size : (count + 1) * size], [nf])
    if count == 0:
        w = w + state[late:one] - missed @ np.ones(no)
    chances = np.zeros(len(chain.names))
    chances[free] = v
    chances[waits] = w[waits[owing]]
    return float((np.eye(len(chain.names))[0] @ expm(q * first)) @ chances)


def wide_response(chain: MarkovChain, effect: Formula, low: float, high: float, last: float) -> float:
    """The probability of `true -->[low,high] effect` up to `last`: gaps of at most high - low from `low` on."""
    return response(chain, Constant(True), effect, high - low, last, first=low)


def ring(names: Sequence[str], means: Sequence[float], stays: float = 0.6) -> MarkovChain:
    """A chain that goes on to the next location with chance `stays`, to the one after it otherwise."""
    n = len(names)
    to = stays * np.roll(np.eye(n), 1, axis=1) + (1.0 - stays) * np.roll(np.eye(n), 2, axis=1)
    return MarkovChain(tuple(names), tuple(means), to)
