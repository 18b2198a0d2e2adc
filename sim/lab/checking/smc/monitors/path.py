"""From a query's path to what follows it along the runs: its monitor, where steps must end for it, and its verdict."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

import numpy as np

from sim.lab.checking.query import Always, BoundedResponse, Not, Operation, Path, Until
from sim.lab.checking.smc.monitors.formula import CompiledFormulas, affine, compile_formulas
from sim.lab.checking.smc.monitors.monitor import EventuallyMonitor, Monitor, UntilMonitor
from sim.lab.checking.smc.monitors.response import ResponseMonitor
from sim.lab.checking.smc.paths import MAX_PIECE_S, Affine, Cuts
from sim.sha import Array, Mask


@dataclass(frozen=True, slots=True)
class PreparedPath:
    """A path made ready: its formulas over common lines, and the bound (s) of its question."""

    path: Path
    compiled: CompiledFormulas
    bound: float

    @property
    def horizon(self) -> float:
        """How far runs must go (s): to the bound, or until the effect of a cause at the bound is due."""
        if isinstance(self.path, BoundedResponse) and not self.path.weak:
            return self.bound + self.path.span.high
        return self.bound

    def start(self, runs: int) -> EventuallyMonitor | UntilMonitor | ResponseMonitor:
        """A monitor of `runs` new runs."""
        span = self.path.span
        if isinstance(self.path, BoundedResponse):
            return ResponseMonitor(
                compiled=self.compiled,
                low=span.low,
                high=span.high,
                until=self.horizon - span.high,
                bound=self.bound,
                runs=runs,
            )
        make = UntilMonitor if isinstance(self.path, Until) else EventuallyMonitor
        return make(self.compiled, span.low, min(span.high, self.bound), runs)

    def verdict(self, monitor: Monitor) -> Mask:
        """(n,) whether the path holds on each run that the monitor has seen."""
        if isinstance(monitor, ResponseMonitor):
            return ~monitor.failed()
        if isinstance(monitor, EventuallyMonitor):
            return ~monitor.satisfied if isinstance(self.path, Always) else monitor.satisfied
        return monitor.satisfied if isinstance(monitor, UntilMonitor) else np.empty(0, dtype=np.bool_)

    def goal_moment(self, monitor: Monitor) -> Array | None:
        """(n,) the moment (s) of the goal (for `[]`: of the violation), inf without; None for a response."""
        return monitor.when if isinstance(monitor, EventuallyMonitor | UntilMonitor) else None


def prepare_path(path: Path, names: tuple[str, ...], bound: float) -> PreparedPath:
    """The path made ready for a model with the locations `names`. Raises ValueError for what cannot be followed."""
    if isinstance(path, Until):
        return PreparedPath(path, compile_formulas((Not(path.hold), path.goal), names), bound)
    if isinstance(path, BoundedResponse):
        return PreparedPath(path, compile_formulas((path.cause, path.effect), names), bound)
    inner = Not(path.inner) if isinstance(path, Always) else path.inner
    return PreparedPath(path, compile_formulas((inner,), names), bound)


def cuts(paths: Sequence[PreparedPath]) -> Cuts:
    """Where the runs' steps must end for these paths: at the ends of spans, and where a condition on clocks changes."""
    bound = max(path.horizon for path in paths)
    instants: set[float] = set()
    clocks: set[Affine] = set()
    looked = []
    for prepared in paths:
        path, compiled = prepared.path, prepared.compiled
        # Each path ends at its own bound, which for a comparison's one side may lie before the end of the runs.
        if isinstance(path, BoundedResponse):
            low, high = 0.0, prepared.horizon
            instants |= {prepared.horizon - path.span.high, prepared.bound}
        else:
            low, high = path.span.low, min(path.span.high, prepared.bound)
        instants |= {low, high}
        if compiled.lines or _is_nonlinear(prepared):
            # What must hold before the goal, and a cause, count from the start on, whatever the span says.
            looked.append((0.0 if isinstance(path, Until | BoundedResponse) else min(low, bound), high))
        for compare in compiled.clocks:
            coefficients = affine(Operation("-", compare.left, compare.right))
            if coefficients is not None and (coefficients[1] or coefficients[2]):
                clocks.add(coefficients)
    # c + t * time + g * age = 0: without g it is the same instant for all runs, else one in each stay.
    instants |= {-c / t for c, t, g in clocks if g == 0.0}
    mixed = tuple(sorted(line for line in clocks if line[2] != 0.0))
    ordered = any(isinstance(each.path, Until | BoundedResponse) and each.compiled.lines for each in paths)
    longest = MAX_PIECE_S if ordered or any(map(_is_nonlinear, paths)) else inf
    inside = tuple(sorted(time for time in instants if 0.0 <= time <= bound))
    # A line that moves, or a condition that is looked at once in each piece, is not known from a longer step's ends.
    fixed = all(each.compiled.still and not _is_nonlinear(each) for each in paths)
    lines = {line.level for each in paths for line in each.compiled.lines if line.level is not None}
    return Cuts(
        bound=bound,
        instants=inside,
        clocks=mixed,
        looked=tuple(looked),
        longest=longest,
        lines=tuple(sorted(lines)) if fixed else None,
    )


def _is_nonlinear(prepared: PreparedPath) -> bool:
    """Whether a condition on clocks is not linear in them."""
    return any(affine(Operation("-", compare.left, compare.right)) is None for compare in prepared.compiled.clocks)


def approximations(prepared: PreparedPath) -> tuple[str, ...]:
    """What is not exact in following this path, and how far beyond the bound it is followed, one sentence each."""
    sentences = []
    if _is_nonlinear(prepared):
        sentences.append(
            "a condition on clocks that is not linear in them is looked at once in each step of at most 4 s"
        )
    if len({up for _, up in prepared.compiled.watched}) == 2:
        sentences.append("a rise and a fall of the temperature within one step are drawn as if independent")
    if isinstance(prepared.path, BoundedResponse) and not prepared.path.weak:
        sentences.append(
            f"each cause up to {prepared.bound:g} s is judged: runs are followed to {prepared.horizon:g} s for it"
        )
    if isinstance(prepared.path, BoundedResponse) and prepared.compiled.lines:
        sentences.append("the moment at which a temperature is crossed is known to within a step of at most 4 s")
    return tuple(sentences)
