"""A model verified before it may run: its graph's structure, and what its temperature can do under any events.

Every check is `proven`, `refuted` (with evidence) or honestly `not decided`. Blocking checks decide whether the model
is deployable; the others are facts that a reader should know.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from sim.checking.proof import structure
from sim.checking.proof.bounds import Bounds, Verdict, find_bounds, noise_band
from sim.checking.proof.counterexample import MOST_STAYS
from sim.checking.proof.envelope import DAY, Assumptions, Range, UnboundedInput, describe
from sim.checking.proof.forcing import UnboundedEffect
from sim.checking.proof.runnable import announced, faults, unexecuted
from sim.checking.proof.wear import worn
from sim.checking.proof.word import TimedWord
from sim.effects import corrected, growing_from, in_sensor_scale, signals_of
from sim.sha import RELAXING, SHA, Model, Trace, alphabet_symbols, nondeterminism

SLACK = 0.1
"""Share of the range's width by which the mean course of a deployable model may pass a border."""
MOST_DOUBT = 1.0
"""Share of the range's width that a location's own doubt of its target excuses at most in the mean course."""
GAINS = (0.5, 2.0)
"""What the gain of a correction may be: beyond it, it calibrates no sensor but hides a wrong model."""
NOISE_SECONDS = 60.0
"""The time over which the noise of flows that do not relax is looked at."""
HORIZONS = (365, 180, 90, 60, 30, 14, 7)
"""Days after the beginning of a wear for which a model is verified, the longest that can be proven."""
DEFAULT = Assumptions()

Clock = Callable[[], float]


@dataclass(frozen=True, slots=True)
class Check:
    """One statement about a model. `details` are the single cases, `words` counterexamples, `seconds` the time needed.

    `blocking`: unless it is proven, the model is not deployable.
    """

    name: str
    verdict: Verdict
    evidence: str
    details: tuple[str, ...] = ()
    words: tuple[TimedWord, ...] = ()
    blocking: bool = True
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class Verification:
    """All checks of a model. `bounds` holds the intervals by location, None where the model cannot be run.

    `assumptions` are the sentences under which the statements about temperatures hold.
    """

    name: str
    checks: tuple[Check, ...]
    assumptions: tuple[str, ...]
    bounds: Bounds | None = None

    @property
    def deployable(self) -> bool:
        """Whether every blocking check is proven."""
        return not self.reasons

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why the model is not deployable, one sentence each."""
        return tuple(
            f"{check.name} {check.verdict}: {check.evidence}"
            for check in self.checks
            if check.blocking and check.verdict != "proven"
        )

    @property
    def executable(self) -> bool:
        """Whether the model can be run at all, deployable or not."""
        return all(check.verdict == "proven" for check in self.checks if check.name in ("runnable", "determinism"))

    def check(self, name: str) -> Check:
        """The check of this name. Raises KeyError."""
        return {check.name: check for check in self.checks}[name]


def verify(
    subject: Model | SHA,
    *,
    symbols: Sequence[str] | None = None,
    traces: Sequence[Trace] = (),
    bounds: Range | None = None,
    assumptions: Assumptions = DEFAULT,
    refusal: str = "",
    clock: Clock = lambda: 0.0,
) -> Verification:
    """Verify a model, or the structure of one that cannot be run (`refusal` says why not).

    `symbols` is the alphabet for input-enabledness: by default the model's, else that of the edges. `traces` (encoded)
    must be accepted. `bounds` is a range (degC) that T is claimed to keep, and then blocks; by default the model's own
    range is looked at, and what blocks is growth without bound, a mean course outside of the range (by more than SLACK
    and the model's own doubt), and noise that is wider than it.
    `clock` gives seconds for the times that the checks report. Raises ValueError for assumptions that do not fit.
    """
    sha = subject.sha if isinstance(subject, Model) else subject
    own = alphabet_symbols(subject.alphabet) if isinstance(subject, Model) else ()
    alphabet = tuple(symbols or own or structure.symbols_of(sha))
    timed = _Stopwatch(clock)
    checks = [
        timed(_runnable(subject, refusal)),
        timed(_determinism(sha)),
        *([timed(_alphabet(subject))] if isinstance(subject, Model) else []),
        timed(_input_enabled(sha, alphabet)),
        timed(_reachability(sha)),
        timed(_dead_ends(sha)),
    ]
    if traces:
        checks.append(timed(_acceptance(sha, traces)))
    found: Bounds | None = None
    # A range for what drives nothing would be a slip of the pen, and change nothing.
    driving = dict.fromkeys(given.signal for location in sha.locations for given in location.flow.inputs)
    driving |= dict.fromkeys(signals_of(sha))
    strange = next((name for name in assumptions.inputs if name not in driving), None)
    if strange is not None:
        known = f"they are driven by {', '.join(driving)}" if driving else "none is driven by any signal"
        raise ValueError(f"no flow of {sha.name!r} is driven by {strange!r}; {known}")
    if isinstance(subject, Model) and all(check.verdict == "proven" for check in checks[:2]):
        found, temperature = _lasting(subject, bounds, assumptions, timed)
        checks += temperature
    else:
        said = "the model cannot be run, so nothing is said of temperatures"
        checks.append(Check("bounds", "not decided", said, blocking=bounds is not None))
    return Verification(sha.name, tuple(checks), describe(assumptions), found)


@dataclass(slots=True)
class _Stopwatch:
    """Stamps each check with the seconds since the one before."""

    clock: Clock
    last: float = 0.0

    def __post_init__(self) -> None:
        self.last = self.clock()

    def __call__(self, check: Check) -> Check:
        before, self.last = self.last, self.clock()
        return replace(check, seconds=self.last - before)


# ------------------------------------------------------------------ structure


def _runnable(subject: Model | SHA, refusal: str) -> Check:
    found = faults(subject) if isinstance(subject, Model) else unexecuted(subject)
    if not found and not isinstance(subject, Model):
        return Check("runnable", "refuted", refusal or "only the structure is known, no flows")
    if not found:
        return Check("runnable", "proven", "every flow, law and entry mode can be executed, and no edge has a guard")
    more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
    return Check("runnable", "refuted", found[0] + more, found)


def _alphabet(model: Model) -> Check:
    fault = announced(model)
    if not fault:
        count = len(alphabet_symbols(model.alphabet))
        return Check("alphabet", "proven", f"signals of the plant announce {count} symbols, some of them on edges")
    return Check("alphabet", "refuted", f"no plant could run it: {fault}")


def _determinism(sha: SHA) -> Check:
    conflicts = tuple(nondeterminism(sha))
    if not conflicts:
        return Check("determinism", "proven", f"no location has two targets on one symbol ({len(sha.edges)} edges)")
    return Check("determinism", "refuted", f"{len(conflicts)} conflicts, the first: {conflicts[0]}", conflicts)


def _input_enabled(sha: SHA, symbols: Sequence[str]) -> Check:
    lacking = structure.missing(sha, symbols)
    if not lacking:
        said = f"all {len(sha.locations)} locations have an edge for each of the {len(symbols)} symbols"
        return Check("input-enabled", "proven", said, blocking=False)
    details = tuple(f"location {name!r} lacks {', '.join(lacks)}" for name, lacks in lacking.items())
    name, lacks = next(iter(lacking.items()))
    more = f" and {len(lacks) - 3} more" if len(lacks) > 3 else ""
    first = f"the first, {name!r}, lacks {', '.join(lacks[:3])}{more}"
    said = f"{len(lacking)} of {len(sha.locations)} locations lack a symbol of {len(symbols)}; {first}"
    return Check("input-enabled", "refuted", said, details, blocking=False)


def _reachability(sha: SHA) -> Check:
    lost = structure.unreachable(sha)
    if not lost:
        said = f"all {len(sha.locations)} locations are reached from {sha.initial!r}"
        return Check("reachability", "proven", said, blocking=False)
    said = f"{len(lost)} of {len(sha.locations)} locations are never reached, the first: {lost[0]!r}"
    return Check("reachability", "refuted", said, lost, blocking=False)


def _dead_ends(sha: SHA) -> Check:
    ends, traps, groups = structure.dead_ends(sha), structure.traps(sha), structure.components(sha)
    shape = f"{len(groups)} strongly connected components, the largest of {len(groups[0])} locations"
    kept = tuple(f"once in {group[0]!r}, only {len(group)} locations are ever seen again" for group in traps)
    if not ends:
        said = "; ".join(("every location has a way out", shape, *kept))
        return Check("dead ends", "proven", said, kept, blocking=False)
    details = (*(f"location {name!r} has no way out" for name in ends), *kept)
    said = f"{len(ends)} of {len(sha.locations)} locations have no way out, the first: {ends[0]!r}; {shape}"
    return Check("dead ends", "refuted", said, details, blocking=False)


def _acceptance(sha: SHA, traces: Sequence[Trace]) -> Check:
    results = [structure.accept(sha, trace.events, trace.name) for trace in traces]
    stopped = tuple(one.sentence for one in results if one.index is not None)
    if not stopped:
        events = sum(one.events for one in results)
        return Check("acceptance", "proven", f"all {len(results)} traces are accepted ({events} events)")
    return Check("acceptance", "refuted", f"{len(stopped)} of {len(results)} traces; {stopped[0]}", stopped)


# ------------------------------------------------------------------ temperatures


def _lasting(
    model: Model, claimed: Range | None, assumptions: Assumptions, timed: _Stopwatch
) -> tuple[Bounds | None, list[Check]]:
    """All that is said of temperatures, for the longest of HORIZONS for which a wear lets the model be deployed.

    Where there is none, or the horizon is given, it is said for that of a year, or for the given one.
    """
    if not growing_from(model.sha):
        return _decided(model, claimed, assumptions, timed)
    given = assumptions.horizon
    horizons = [days * DAY for days in HORIZONS] if given is None else [given]
    first: tuple[Bounds | None, list[Check]] | None = None
    for horizon in horizons:
        found, checks = _decided(model, claimed, replace(assumptions, horizon=horizon), timed)
        against = [f"{each.name} {each.verdict}" for each in checks if each.blocking and each.verdict != "proven"]
        first = first or (found, checks)
        if not against:
            said = worn(model.sha, horizon, horizons[0])
            return found, [*checks, timed(Check("wear", "proven", said))]
    return first or (None, [])


def _decided(
    model: Model, claimed: Range | None, assumptions: Assumptions, timed: _Stopwatch
) -> tuple[Bounds | None, list[Check]]:
    """All that is said of temperatures; not decided without a range, without a bound, or where numbers overflow."""
    try:
        # An overflow would come out as an infinite bound, which reads like growth: it is an error instead.
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            sha = in_sensor_scale(model).sha
            low, high = claimed or (sha.low, sha.high)
            found = find_bounds(model, low, high, assumptions)
            checks = [timed(_within(found, model, assumptions, blocking=claimed is not None))]
            # A claim may have an infinite border, which growth would never pass: growth is judged by the model's range.
            own = found if claimed is None else find_bounds(model, sha.low, sha.high, assumptions)
            checks.append(timed(_growth(own, model)))
            width = sha.high - sha.low
            wider = sha.low - SLACK * width, sha.high + SLACK * width
            course = find_bounds(model, *wider, assumptions, doubt=MOST_DOUBT * width)
            checks += [timed(_mean_course(course, assumptions.z)), timed(_noise_check(model, assumptions.z))]
            return found, checks if model.correction.identity else [*checks, timed(_correction(model))]
    except (UnboundedInput, UnboundedEffect) as error:
        return None, [Check("growth", "not decided", str(error))]
    except ArithmeticError as error:
        said = f"the model's numbers lead beyond what can be computed ({error}); give parameters of a usual size"
        return None, [Check("growth", "not decided", said)]


def _within(found: Bounds, model: Model, assumptions: Assumptions, *, blocking: bool) -> Check:
    claim = f"[{found.low:g}, {found.high:g}] degC"
    lows, highs = zip(*found.intervals.values(), strict=True)
    details = tuple(f"{name}: {low:.4g} to {high:.4g} degC" for name, (low, high) in found.intervals.items())
    if found.verdict == "proven":
        said = f"T stays within {claim}: from {min(lows):.4g} to {max(highs):.4g}; {_noise(model, assumptions.z)}"
        return Check("bounds", "proven", said, details, blocking=blocking)
    said = "; ".join(_way_out(found, one.up) for one in found.escapes) or "the bounds did not settle"
    hidden = in_sensor_scale(model).sha
    clamp = f"; the model's clamp to [{hidden.low:g}, {hidden.high:g}] would hide it and is left out here"
    words = tuple(one.word for one in found.escapes if one.word is not None)
    return Check("bounds", found.verdict, f"T can leave {claim}: {said}{clamp}", details, words, blocking=blocking)


def _way_out(found: Bounds, up: bool) -> str:
    one = next(each for each in found.escapes if each.up == up)
    border = f"{'above' if up else 'below'} {found.high if up else found.low:g}"
    reach = "without bound" if one.grows else f"as far as {one.reach:.4g}"
    if one.word is None:
        return f"{border} ({reach}), but no word of at most {MOST_STAYS} stays was found that does it"
    return f"{border} in {one.location!r} after {len(one.word.steps)} stays and {one.seconds:.6g} s ({reach})"


def _noise(model: Model, z: float) -> str:
    settled, walking = noise_band(model, z)
    said = f"noise adds up to {settled:.3g} degC at z = {z:g} where a flow relaxes"
    if not walking:
        return said
    name = max(walking, key=lambda each: walking[each])
    most = f"most in {name!r}: {walking[name]:.3g} degC/sqrt(s)"
    return f"{said}, and grows with the time spent in {len(walking)} others ({most})"


def _growth(found: Bounds, model: Model) -> Check:
    growing = [one for one in found.escapes if one.grows]
    if not found.settled:
        return Check("growth", "not decided", "the bounds did not settle in the rounds that they are given")
    if not growing:
        lows, highs = zip(*found.intervals.values(), strict=True)
        return Check("growth", "proven", f"T never passes {min(lows):.4g} or {max(highs):.4g} degC, whatever happens")
    words = tuple(one.word for one in growing if one.word is not None)
    directions = " and ".join("upwards" if one.up else "downwards" for one in growing)
    said = "; ".join(_way_out(found, one.up) for one in growing)
    kinds = {each.name: each.flow.kind for each in model.sha.locations if each.flow.kind not in (*RELAXING, "constant")}
    name = next((one.location for one in growing if one.location in kinds), next(iter(kinds), ""))
    cause = f"; the flow of {name!r} is {kinds[name]}, which has no target" if name else ""
    evidence = f"T grows {directions} without bound: {said}{cause}"
    return Check("growth", "refuted" if words else "not decided", evidence, (), words)


def _mean_course(mean: Bounds, z: float) -> Check:
    span = f"[{mean.low:g}, {mean.high:g}] degC (the model's range and {SLACK:.0%} of its width)"
    doubt = f"given the benefit of its own doubt (z = {z:g}, at most the range's width)"
    if mean.verdict == "proven":
        said = f"with what is drawn at its mean, and each target {doubt}, T stays within {span}"
        return Check("mean course", "proven", said)
    said = "; ".join(_way_out(mean, one.up) for one in mean.escapes) or "the bounds did not settle"
    words = tuple(one.word for one in mean.escapes if one.word is not None)
    evidence = f"with what is drawn at its mean, and even with each target {doubt}, T leaves {span}: {said}"
    return Check("mean course", mean.verdict, evidence, (), words)


def _correction(model: Model) -> Check:
    """The range is carried along by a correction, so that a wrong one would move what is measured by."""
    gain, offset = model.correction.gain, model.correction.offset
    low, high = model.sha.low, model.sha.high
    middle = corrected(model.correction, 0.5 * (low + high))
    said = f"T' = {gain:.4g} T {offset:+.4g} degC, which puts the middle of the range at {middle:.4g} degC"
    if GAINS[0] <= gain <= GAINS[1] and low <= middle <= high:
        return Check("correction", "proven", said)
    wanted = f"a sensor's calibration has a gain of {GAINS[0]:g} to {GAINS[1]:g} and leaves the middle in the range"
    return Check("correction", "refuted", f"{said}; {wanted}")


def _noise_check(model: Model, z: float) -> Check:
    """Noise is no matter of words: what it would need to hide the whole range is told, and blocks."""
    settled, walking = noise_band(model, z)
    sha = in_sensor_scale(model).sha
    width = sha.high - sha.low
    worst = {name: z * noise * sqrt(NOISE_SECONDS) for name, noise in walking.items()}
    name = max(worst, key=lambda each: worst[each], default="")
    said = f"{_noise(model, z)}; the sensor's is {model.sensor_sigma:.3g} degC"
    wide = max(settled, z * model.sensor_sigma, worst.get(name, 0.0))
    if wide <= width:
        return Check("noise", "proven", said)
    return Check(
        "noise",
        "refuted",
        f"at z = {z:g} noise reaches {wide:.3g} degC (over {NOISE_SECONDS:g} s where it grows), which is wider than "
        f"the model's range of {width:g} degC, so that nothing is predicted: {said}",
    )
