"""From a query's path to what follows it along the runs: its monitor, where steps must end for it, and its verdict."""

from dataclasses import dataclass
from math import inf, isfinite

import numpy as np

from sim.checking.query.tree import Always, BoundedResponse, Not, Operation, Path, Until
from sim.checking.smc.monitors.formula import Lines, affine, compile_formulas
from sim.checking.smc.monitors.monitor import Answered, Holds, Monitor, Reach
from sim.checking.smc.paths.known import Affine, Cuts
from sim.checking.smc.paths.plan import LONGEST
from sim.sha.trace import Array, Mask


@dataclass(frozen=True, slots=True)
class Watch:
    """A path made ready: its formulas over common lines, and the bound (s) of its question."""

    path: Path
    lines: Lines
    bound: float

    def start(self, runs: int) -> Reach | Holds | Answered:
        """A monitor of `runs` new runs."""
        span, none, never = self.path.span, np.zeros(runs, dtype=np.bool_), np.full(runs, inf)
        high = min(span.high, self.bound)
        if isinstance(self.path, Until):
            return Holds(self.lines, span.low, high, none, none.copy(), never)
        if isinstance(self.path, BoundedResponse):
            return Answered(self.lines, span.low, span.high, self.bound, runs)
        return Reach(self.lines, span.low, high, none, never)

    def verdict(self, monitor: Monitor) -> Mask:
        """(n,) whether the path holds on each run that the monitor has seen."""
        if isinstance(monitor, Answered):
            return ~monitor.failed()
        if isinstance(monitor, Reach):
            return ~monitor.found if isinstance(self.path, Always) else monitor.found
        return monitor.found if isinstance(monitor, Holds) else np.empty(0, dtype=np.bool_)

    def when(self, monitor: Monitor) -> Array | None:
        """(n,) the moment (s) of the goal (for `[]`: of the violation), inf without; None for a response."""
        return monitor.when if isinstance(monitor, Reach | Holds) else None


def watch(path: Path, names: tuple[str, ...], bound: float) -> Watch:
    """The path made ready for a model with the locations `names`. Raises ValueError for what cannot be followed."""
    if isinstance(path, Until):
        return Watch(path, compile_formulas((Not(path.hold), path.goal), names), bound)
    if isinstance(path, BoundedResponse):
        return Watch(path, compile_formulas((path.cause, path.effect), names), bound)
    inner = Not(path.inner) if isinstance(path, Always) else path.inner
    return Watch(path, compile_formulas((inner,), names), bound)


def cuts(watches: tuple[Watch, ...], bound: float) -> Cuts:
    """Where the runs' steps must end for these paths."""
    instants: set[float] = set()
    clocks: set[Affine] = set()
    looked = []
    for one in watches:
        span = one.path.span
        whole = isinstance(one.path, Until | BoundedResponse)
        low, high = (0.0, bound) if isinstance(one.path, BoundedResponse) else (span.low, min(span.high, bound))
        instants |= {time for time in (low, high) if isfinite(time) and 0.0 < time <= bound}
        if one.lines.lines or _bent(one):
            looked.append((0.0 if whole else min(low, bound), high))
        for compare in one.lines.clocks:
            found = affine(Operation("-", compare.left, compare.right))
            if found is not None and (found[1] or found[2]):
                clocks.add(found)
        instants |= {-line[0] / line[1] for line in clocks if line[2] == 0.0}
    mixed = tuple(sorted(line for line in clocks if line[2] != 0.0))
    ordered = any(isinstance(one.path, Until | BoundedResponse) and one.lines.lines for one in watches)
    longest = LONGEST if ordered or any(map(_bent, watches)) else inf
    inside = tuple(sorted(time for time in instants if 0.0 <= time <= bound))
    return Cuts(bound, inside, mixed, tuple(looked), longest)


def _bent(one: Watch) -> bool:
    """Whether a condition on clocks is not linear in them."""
    return any(affine(Operation("-", compare.left, compare.right)) is None for compare in one.lines.clocks)


def approximations(one: Watch) -> tuple[str, ...]:
    """What is not exact in following this path, one sentence each."""
    said = []
    if _bent(one):
        said.append("a condition on clocks that is not linear in them is looked at once in each step of at most 4 s")
    if len({up for _, up in one.lines.watched}) == 2:
        said.append("a rise and a fall of the temperature within one step are drawn as if independent")
    if isinstance(one.path, BoundedResponse) and one.lines.lines:
        said.append("the moment at which a temperature is crossed is known to within a step of at most 4 s")
    return tuple(said)
