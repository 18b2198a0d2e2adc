"""A model verified before it may run: its graph's structure, and what its temperature can do under any events.

Every check is `proven`, `refuted` (with evidence) or honestly `not decided`. Blocking checks decide whether the model
is deployable; the others are facts that a reader should know.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from sim.effects import apply_correction, effect_signals, growth_starts, in_sensor_scale
from sim.proof import structure
from sim.proof.bounds import Bounds, Verdict, find_bounds, noise_band
from sim.proof.counterexample import MAX_STAYS
from sim.proof.envelope import DAY_S, Assumptions, Range, UnboundedInput, describe
from sim.proof.forcing import UnboundedEffect
from sim.proof.runnable import faults, guard_notes, silence_reason
from sim.proof.wear import wear_sentence
from sim.proof.word import TimedWord
from sim.sha import RELAXING_FLOWS, SHA, Model, Trace, alphabet_symbols, nondeterminism

MEAN_COURSE_SLACK = 0.1
"""Share of the range's width by which the mean course of a deployable model may pass a border."""
MAX_DOUBT_SHARE = 1.0
"""Share of the range's width that a location's own doubt of its target excuses at most in the mean course."""
GAIN_RANGE = (0.5, 2.0)
"""What the gain of a correction may be: beyond it, it calibrates no sensor but hides a wrong model."""
NOISE_SPAN_S = 60.0
"""The time over which the noise of flows that do not relax is looked at."""
WEAR_HORIZONS_DAYS = (365, 180, 90, 60, 30, 14, 7)
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
    range is looked at, and what blocks is growth without bound, a mean course outside of the range (by more than
    MEAN_COURSE_SLACK and the model's own doubt), and noise that is wider than it.
    `clock` gives seconds for the times that the checks report. Raises ValueError for assumptions that do not fit.
    """
    sha = subject.sha if isinstance(subject, Model) else subject
    own = alphabet_symbols(subject.alphabet) if isinstance(subject, Model) else ()
    alphabet = tuple(symbols or own or structure.edge_symbols(sha))
    timed = _Stopwatch(clock)
    checks = [timed(check) for check in structure_checks(subject, alphabet, traces, refusal)]
    proven: Bounds | None = None
    # A range for what drives nothing would be a slip of the pen, and change nothing.
    driving = dict.fromkeys(driver.signal for location in sha.locations for driver in location.flow.inputs)
    driving |= dict.fromkeys(effect_signals(sha))
    strange = next((name for name in assumptions.inputs if name not in driving), None)
    if strange is not None:
        known = f"they are driven by {', '.join(driving)}" if driving else "none is driven by any signal"
        raise ValueError(f"no flow of {sha.name!r} is driven by {strange!r}; {known}")
    if isinstance(subject, Model) and all(check.verdict == "proven" for check in checks[:2]):
        proven, temperature = _check_horizons(subject, bounds, assumptions, timed)
        checks += temperature
    else:
        evidence = "the model cannot be run, so nothing is said of temperatures"
        checks.append(Check("bounds", "not decided", evidence, blocking=bounds is not None))
    return Verification(sha.name, tuple(checks), describe(assumptions), proven)


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


def structure_checks(
    subject: Model | SHA, symbols: Sequence[str], traces: Sequence[Trace], refusal: str
) -> Iterator[Check]:
    """Whether the model can be run at all, and what its graph alone says; a check is made when it is asked for."""
    model = subject if isinstance(subject, Model) else None
    sha = subject.sha if isinstance(subject, Model) else subject
    count = len(sha.locations)

    reasons = guard_notes(sha) if model is None else faults(model)
    if reasons:
        more = f" (and {len(reasons) - 1} more)" if len(reasons) > 1 else ""
        yield Check("runnable", "refuted", reasons[0] + more, reasons)
    elif model is None:
        yield Check("runnable", "refuted", refusal or "only the structure is known, no flows")
    else:
        yield Check("runnable", "proven", "every flow, law and entry mode can be executed, and no edge has a guard")

    conflicts = tuple(nondeterminism(sha))
    if conflicts:
        evidence = f"{len(conflicts)} conflicts, the first: {conflicts[0]}"
        yield Check("determinism", "refuted", evidence, conflicts)
    else:
        yield Check("determinism", "proven", f"no location has two targets on one symbol ({len(sha.edges)} edges)")

    if model is not None:
        fault = silence_reason(model)
        known = len(alphabet_symbols(model.alphabet)) if not fault else 0
        evidence = f"signals of the plant announce {known} symbols, some of them on edges"
        evidence = f"no plant could run it: {fault}" if fault else evidence
        yield Check("alphabet", "refuted" if fault else "proven", evidence)

    # A location without an edge for a symbol, or that nothing leads to, is a fact about what was seen and no fault: a
    # gateway resynchronises. These do not block.
    lacking = structure.missing(sha, symbols)
    if lacking:
        details = tuple(f"location {name!r} lacks {', '.join(lacks)}" for name, lacks in lacking.items())
        name, lacks = next(iter(lacking.items()))
        more = f" and {len(lacks) - 3} more" if len(lacks) > 3 else ""
        first = f"the first, {name!r}, lacks {', '.join(lacks[:3])}{more}"
        evidence = f"{len(lacking)} of {count} locations lack a symbol of {len(symbols)}; {first}"
        yield Check("input-enabled", "refuted", evidence, details, blocking=False)
    else:
        evidence = f"all {count} locations have an edge for each of the {len(symbols)} symbols"
        yield Check("input-enabled", "proven", evidence, blocking=False)

    lost = structure.unreachable(sha)
    if lost:
        evidence = f"{len(lost)} of {count} locations are never reached, the first: {lost[0]!r}"
        yield Check("reachability", "refuted", evidence, lost, blocking=False)
    else:
        evidence = f"all {count} locations are reached from {sha.initial!r}"
        yield Check("reachability", "proven", evidence, blocking=False)

    ends, groups = structure.dead_ends(sha), structure.components(sha)
    shape = f"{len(groups)} strongly connected components, the largest of {len(groups[0])} locations"
    kept = tuple(
        f"once in {group[0]!r}, only {len(group)} locations are ever seen again" for group in structure.traps(sha)
    )
    if ends:
        details = (*(f"location {name!r} has no way out" for name in ends), *kept)
        evidence = f"{len(ends)} of {count} locations have no way out, the first: {ends[0]!r}; {shape}"
        yield Check("dead ends", "refuted", evidence, details, blocking=False)
    else:
        evidence = "; ".join(("every location has a way out", shape, *kept))
        yield Check("dead ends", "proven", evidence, kept, blocking=False)

    if traces:
        results = [structure.accept(sha, trace.events, trace.name) for trace in traces]
        stopped = tuple(result.sentence for result in results if result.index is not None)
        if stopped:
            evidence = f"{len(stopped)} of {len(results)} traces; {stopped[0]}"
            yield Check("acceptance", "refuted", evidence, stopped)
        else:
            events = sum(result.events for result in results)
            yield Check("acceptance", "proven", f"all {len(results)} traces are accepted ({events} events)")


# ------------------------------------------------------------------ temperatures


def _check_horizons(
    model: Model, claimed: Range | None, assumptions: Assumptions, timed: _Stopwatch
) -> tuple[Bounds | None, list[Check]]:
    """All that is said of temperatures, for the longest of WEAR_HORIZONS_DAYS for which a wear lets the model be
    deployed.

    Where there is none, or the horizon is given, it is said for that of a year, or for the given one.
    """
    if not growth_starts(model.sha):
        return _check_temperatures(model, claimed, assumptions, timed)
    horizons = [days * DAY_S for days in WEAR_HORIZONS_DAYS] if assumptions.horizon is None else [assumptions.horizon]
    # From the longest on, so that the first that is proven is the longest. Where none is, the longest one's reasons are
    # told: they name what the wear will come to.
    first: tuple[Bounds | None, list[Check]] | None = None
    for horizon in horizons:
        bounds, checks = _check_temperatures(model, claimed, replace(assumptions, horizon=horizon), timed)
        first = first or (bounds, checks)
        if all(check.verdict == "proven" for check in checks if check.blocking):
            evidence = wear_sentence(model.sha, horizon, horizons[0])
            return bounds, [*checks, timed(Check("wear", "proven", evidence))]
    return first or (None, [])


def _check_temperatures(
    model: Model, claimed: Range | None, assumptions: Assumptions, timed: _Stopwatch
) -> tuple[Bounds | None, list[Check]]:
    """All that is said of temperatures; not decided without a range, without a bound, or where numbers overflow."""
    try:
        # An overflow would come out as an infinite bound, which reads like growth: it is an error instead.
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            sha = in_sensor_scale(model).sha
            low, high = claimed or (sha.low, sha.high)
            bounds = find_bounds(model, low, high, assumptions)
            checks = [timed(_check_range(bounds, model, assumptions, blocking=claimed is not None))]
            # A claim may have an infinite border, which growth would never pass: growth is judged by the model's range.
            own = bounds if claimed is None else find_bounds(model, sha.low, sha.high, assumptions)
            checks.append(timed(_growth(own, model)))
            width = sha.high - sha.low
            wider = sha.low - MEAN_COURSE_SLACK * width, sha.high + MEAN_COURSE_SLACK * width
            course = find_bounds(model, *wider, assumptions, doubt=MAX_DOUBT_SHARE * width)
            checks += [timed(_mean_course(course, model, assumptions.z)), timed(_noise_check(model, assumptions.z))]
            return bounds, checks if model.correction.identity else [*checks, timed(_correction(model))]
    except (UnboundedInput, UnboundedEffect) as error:
        return None, [Check("growth", "not decided", str(error))]
    except ArithmeticError as error:
        evidence = f"the model's numbers lead beyond what can be computed ({error}); give parameters of a usual size"
        return None, [Check("growth", "not decided", evidence)]


def _check_range(bounds: Bounds, model: Model, assumptions: Assumptions, *, blocking: bool) -> Check:
    claim = f"[{bounds.low:g}, {bounds.high:g}] {model.unit}"
    lows, highs = zip(*bounds.intervals.values(), strict=True)
    details = tuple(f"{name}: {low:.4g} to {high:.4g} {model.unit}" for name, (low, high) in bounds.intervals.items())
    if bounds.verdict == "proven":
        evidence = f"T stays within {claim}: from {min(lows):.4g} to {max(highs):.4g}; {_noise(model, assumptions.z)}"
        return Check("bounds", "proven", evidence, details, blocking=blocking)
    ways = "; ".join(_escape_text(bounds, escape.up) for escape in bounds.escapes) or "the bounds did not settle"
    hidden = in_sensor_scale(model).sha
    clamp = f"; the model's clamp to [{hidden.low:g}, {hidden.high:g}] would hide it and is left out here"
    words = tuple(escape.word for escape in bounds.escapes if escape.word is not None)
    return Check("bounds", bounds.verdict, f"T can leave {claim}: {ways}{clamp}", details, words, blocking=blocking)


def _escape_text(bounds: Bounds, up: bool) -> str:
    escape = next(each for each in bounds.escapes if each.up == up)
    border = f"{'above' if up else 'below'} {bounds.high if up else bounds.low:g}"
    reach = "without bound" if escape.grows else f"as far as {escape.reach:.4g}"
    if escape.word is None:
        return f"{border} ({reach}), but no word of at most {MAX_STAYS} stays was found that does it"
    return f"{border} in {escape.location!r} after {len(escape.word.steps)} stays and {escape.seconds:.6g} s ({reach})"


def _noise(model: Model, z: float) -> str:
    settled, walking = noise_band(model, z)
    evidence = f"noise adds up to {settled:.3g} {model.unit} at z = {z:g} where a flow relaxes"
    if not walking:
        return evidence
    name = max(walking, key=lambda each: walking[each])
    most = f"most in {name!r}: {walking[name]:.3g} {model.unit}/sqrt(s)"
    return f"{evidence}, and grows with the time spent in {len(walking)} others ({most})"


def _growth(bounds: Bounds, model: Model) -> Check:
    growing = [escape for escape in bounds.escapes if escape.grows]
    if not bounds.settled:
        return Check("growth", "not decided", "the bounds did not settle in the rounds that they are given")
    if not growing:
        lows, highs = zip(*bounds.intervals.values(), strict=True)
        return Check(
            "growth", "proven", f"T never passes {min(lows):.4g} or {max(highs):.4g} {model.unit}, whatever happens"
        )
    words = tuple(escape.word for escape in growing if escape.word is not None)
    directions = " and ".join("upwards" if escape.up else "downwards" for escape in growing)
    ways = "; ".join(_escape_text(bounds, escape.up) for escape in growing)
    kinds = {
        each.name: each.flow.kind for each in model.sha.locations if each.flow.kind not in (*RELAXING_FLOWS, "constant")
    }
    name = next((escape.location for escape in growing if escape.location in kinds), next(iter(kinds), ""))
    cause = f"; the flow of {name!r} is {kinds[name]}, which has no target" if name else ""
    evidence = f"T grows {directions} without bound: {ways}{cause}"
    return Check("growth", "refuted" if words else "not decided", evidence, (), words)


def _mean_course(mean: Bounds, model: Model, z: float) -> Check:
    span = f"[{mean.low:g}, {mean.high:g}] {model.unit} (the model's range and {MEAN_COURSE_SLACK:.0%} of its width)"
    doubt = f"given the benefit of its own doubt (z = {z:g}, at most the range's width)"
    if mean.verdict == "proven":
        evidence = f"with what is drawn at its mean, and each target {doubt}, T stays within {span}"
        return Check("mean course", "proven", evidence)
    ways = "; ".join(_escape_text(mean, escape.up) for escape in mean.escapes) or "the bounds did not settle"
    words = tuple(escape.word for escape in mean.escapes if escape.word is not None)
    evidence = f"with what is drawn at its mean, and even with each target {doubt}, T leaves {span}: {ways}"
    return Check("mean course", mean.verdict, evidence, (), words)


def _correction(model: Model) -> Check:
    """The range is carried along by a correction, so that a wrong one would move what is measured by."""
    gain, offset = model.correction.gain, model.correction.offset
    low, high = model.sha.low, model.sha.high
    middle = apply_correction(model.correction, 0.5 * (low + high))
    evidence = (
        f"T' = {gain:.4g} T {offset:+.4g} {model.unit}, which puts the middle of the range at {middle:.4g} {model.unit}"
    )
    if GAIN_RANGE[0] <= gain <= GAIN_RANGE[1] and low <= middle <= high:
        return Check("correction", "proven", evidence)
    wanted = (
        f"a sensor's calibration has a gain of {GAIN_RANGE[0]:g} to {GAIN_RANGE[1]:g} and leaves the middle in the "
        "range"
    )
    return Check("correction", "refuted", f"{evidence}; {wanted}")


def _noise_check(model: Model, z: float) -> Check:
    """Noise is no matter of words: what it would need to hide the whole range is told, and blocks."""
    settled, walking = noise_band(model, z)
    sha = in_sensor_scale(model).sha
    width = sha.high - sha.low
    worst = {name: z * noise * sqrt(NOISE_SPAN_S) for name, noise in walking.items()}
    name = max(worst, key=lambda each: worst[each], default="")
    evidence = f"{_noise(model, z)}; the sensor's is {model.sensor_sigma:.3g} {model.unit}"
    wide = max(settled, z * model.sensor_sigma, worst.get(name, 0.0))
    if wide <= width:
        return Check("noise", "proven", evidence)
    return Check(
        "noise",
        "refuted",
        f"at z = {z:g} noise reaches {wide:.3g} {model.unit} (over {NOISE_SPAN_S:g} s where it grows), which is wider "
        f"than the model's range of {width:g} {model.unit}, so that nothing is predicted: {evidence}",
    )
