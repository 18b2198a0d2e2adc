"""What a diagnosis found, as data: the report, the pictures and `diagnosis.json` are made from nothing else."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim.lab.learning import Indices
from sim.sha import DEFAULT_UNIT, Array, EffectLine, Mask, Trace

Verdict = Literal["agree", "named", "class", "unexplained", "too-little-data"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Shift:
    """A parameter of the given model that has moved: `change` is relative to its size (a target's: over rest), None
    where that says nothing, since it moved by more than its size.

    `before` and `after` are its values in `unit`, `sigma` the size of the move over its standard error.
    """

    location: str
    parameter: str
    before: float
    after: float
    unit: str
    change: float | None
    sigma: float


CANNOT_TELL = "these data cannot tell it from the best"
"""The fate of what explains as much as the best does."""


@dataclass(frozen=True, slots=True)
class TriedEffect:
    """An effect of the catalogue against these data, and what became of it.

    `gain` is the log-likelihood that it adds (nats), `confirmed` True where that is of a joint refit with the noise,
    else of the screen. `visible` is the share of its part in the temperature that the model's own parameters cannot
    imitate, `z` its strength over its standard error, `robust` the same by cycles (cluster-robust), `cycles` how many
    cycles speak for it out of those that speak at all. `twins` are entries whose effect looks nearly the same here
    (cosine >= 0.9), `rivals` those with 0.6 to 0.9. `fate` says why it was named or not, in words.
    """

    name: str
    plain: str
    step: int
    gain: float
    confirmed: bool
    visible: float
    z: float
    robust: float
    cycles: tuple[int, int]
    params: Mapping[str, float]
    twins: tuple[str, ...]
    rivals: tuple[str, ...]
    needs: tuple[str, ...]
    experiment: str
    fate: str


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect that the diagnosis adds to the model.

    `members` are the names that these data cannot tell apart (the first is `name`); `confidence` is the share of these
    together in the posterior, in which none of these has one too (`discrepancy.posterior`); `signal_to_noise` is
    the rms of what it does that the model's parameters cannot imitate, over the sensor's sigma. `errors` are standard
    errors by parameter. `look` says what to look at at the machine. `shrinking_shown`: the interval of what is removed
    of the held-out excess lies above zero.
    """

    name: str
    members: tuple[str, ...]
    confidence: float
    gain: float
    margin: float
    params: Mapping[str, float]
    errors: Mapping[str, float]
    signals: Mapping[str, str]
    signal_to_noise: float
    plain: str
    experiment: str
    look: str = ""
    shrinking_shown: bool = True


@dataclass(frozen=True, slots=True)
class TraceOfEffect:
    """An effect that is certain and does not matter: it moves the temperature by `moves` (degC rms), `gain` nats."""

    name: str
    gain: float
    moves: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AbsorbedLaw:
    """One law over `signal` that stands for the model's own targets and gains while the machine runs.

    `name` is the effect that it is, `words` the law, `coefficients` its a, b, ... (degC of target for units of the
    signal). `constants` are the model's numbers, `instead` those of the law; errors (degC rms) are of held-out free
    runs with the one and with the other.
    """

    name: str
    words: str
    signal: str
    coefficients: tuple[float, ...]
    constants: int
    instead: int
    rmse_before: float
    rmse_after: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HeatPlace:
    """A place where unexplained heat lies: in `location`, `seconds` after the event `after`, by strata of a signal.

    `share` is its part of all unexplained heat (energy), `heat` the mean there (degC/h), `cycles` (with the sign of the
    mean, in all), `p` the family-wise probability under sign flips by cycle. `correlates` names a signal, or "";
    `when` says which of its values are meant ("MarciaPmpFango above 0.5"), "" where all are.
    """

    location: str
    after: str
    seconds: tuple[float, float]
    share: float
    heat: float
    cycles: tuple[int, int]
    p: float
    correlates: str
    when: str = ""


@dataclass(frozen=True, slots=True)
class Ceiling:
    """How much of the heat that is left a free learner can predict on cycles it has not seen.

    `share` is the cross-validated share of its variance (at most 1, may be negative), `p` by sign flips of cycles,
    `heat` the rms of all of it (degC/h), `drivers` the features that it used most, with their importance.
    """

    share: float
    p: float
    heat: float
    drivers: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class NoiseFloor:
    """degC rms by which a free run over held-out cycles is off where nothing is missing.

    `interval` holds `DecisionRules.floor_interval_share` of the errors that chance makes over so many cycles, `cycles`
    (c,) are their numbers and `per_cycle` (c,) degC the floor of each. `source` says what it was told from.
    """

    error: float
    interval: tuple[float, float]
    cycles: Indices
    per_cycle: Array
    source: str

    def cycle_floors(self, cycles: Indices) -> Array:
        """degC the floor of each of these cycles, by its number."""
        return np.asarray(self.per_cycle[np.searchsorted(self.cycles, cycles)])


@dataclass(frozen=True, slots=True, kw_only=True)
class GapBeginning:
    """Where over the cycles a gap begins: the start of the first cycle that has it, s UTC, and its 95 % interval.

    `before` and `after` count the cycles, `moves` (degC) is by how much more the free run errs from then on in the mean
    of a cycle, while the machine is `running` or at rest. Of a machine that runs on, `stretch` is the length (s) of the
    pieces of its runs that stand for cycles here; 0: they are cycles. `then` are the start (s UTC) of the first one
    with which the gap changes once more, and by how much more than before the beginning it errs from there on. `acts`
    is what it is most like of all that might act from the beginning on, "" where the errors alone tell it.
    """

    time: float
    interval: tuple[float, float]
    before: int
    after: int
    moves: float
    running: bool
    p: float
    stretch: float = 0.0
    then: tuple[float, float] | None = None
    acts: str = ""


@dataclass(frozen=True, slots=True)
class HeldOutProof:
    """Free runs over cycles that were never fitted: root mean squares in degC, the noise floor, the excess removed.

    `cycles` counts them, `pieces` the independent pieces of evidence in them; `per_cycle` holds (before, after, floor)
    of each cycle. `rmse_given` is of the model as it was given, `rmse_before` with its parameters refitted; where the
    refit foresees these cycles worse it is refused: `rmse_refit` is its error, else None, and before is as given. The
    excess removed (at most 1: all of it, to within the floor) and its interval are None where nothing was named, or
    where the error before is no greater than the floor: then there is no excess.
    """

    cycles: int
    pieces: int
    rmse_given: float
    rmse_before: float
    rmse_after: float
    noise_floor: float
    excess_removed: float | None
    ci95: tuple[float, float] | None
    per_cycle: tuple[tuple[float, float, float], ...]
    rmse_refit: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateLaw:
    """An expression with which goes what has no name: no name either, but something to look at.

    `strength` times `expression` is the heat (degC/s), while the machine runs where `running`. `gain` (nats) is of the
    fitted cycles with the noise fitted anew, and of what it foresees of held-out ones; `share` that of what is left on
    these, `cycles` (better foreseen, in all) those. `tried` are
    the expressions that were searched, which the gain has to pay for; `alike` are others that these data cannot tell
    from it. `line` is the effect that a person may adopt; None where no engine can execute it. `words` are the plant's
    where there are any, with dates; they are the expression too, where it is none that could be written as one.
    """

    expression: str
    running: bool
    strength: float
    gain: float
    share: float
    cycles: tuple[int, int]
    tried: int
    experiment: str
    alike: tuple[str, ...]
    line: EffectLine | None
    words: str = ""


@dataclass(frozen=True, slots=True)
class ExperimentStep:
    """`signal` is set to `value` and kept for so many seconds; 0: the next one is set at the same time."""

    signal: str
    value: float
    seconds: float


@dataclass(frozen=True, slots=True)
class PairOfRivals:
    """Two effects that the measured traces cannot tell apart, and the nats by which an experiment is expected to.

    `most` are those of the best of all schedules for this pair, made as long as an experiment may be. `rows` (s) is
    None, or how close the rows must lie for them: in those of the record one of the two may be too short for a name.
    """

    one: str
    other: str
    nats: float
    most: float
    rows: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ProposedExperiment:
    """What to set at the machine so that rivals are told apart: `what` in words, its `steps`, done `repeats` times.

    `seconds` is how long all of it takes, `pairs` what it is expected to give, the less whichever of the two is true,
    `needed` the nats from which a name can be counted on, `least` those without which there is none. `trace` has the
    set-points as rows.
    """

    what: str
    steps: tuple[ExperimentStep, ...]
    repeats: int
    seconds: float
    pairs: tuple[PairOfRivals, ...]
    needed: float
    least: float
    trace: Trace

    @property
    def enough(self) -> bool:
        """Whether every pair is expected to be told apart, recorded in rows such as those of the traces."""
        return all(pair.nats >= self.needed and pair.rows is None for pair in self.pairs)

    @property
    def inseparable(self) -> tuple[PairOfRivals, ...]:
        """The pairs that no experiment within the machine's ranges is expected to tell apart."""
        return tuple(pair for pair in self.pairs if pair.most < self.least)


@dataclass(frozen=True, slots=True)
class DiagnosisCourse:
    """What the pictures show, over all windows (m,): absolute times, readings, free runs before and after.

    `heat_before` and `heat_after` (m,) degC/h are the implied heats that the models leave; `location` names each
    window's location, `since_event` (m,) the seconds since the last start or stop. NaN where there is none.
    """

    times: Array
    reading: Array
    before: Array
    after: Array
    held_out: Array
    heat_before: Array
    heat_after: Array
    location: tuple[str, ...]
    since_event: Array
    cycle: Array


@dataclass(frozen=True, slots=True, kw_only=True)
class MissingHeat:
    """The heat (degC/h) that the refitted model lacks to follow the measurement, over all windows (m,), in time.

    `times` are absolute s, `mean` what is likely, `low` and `high` its 95 % band. `running` says whether the machine
    ran, `held_out` whether the model was fitted without the window.
    """

    times: Array
    mean: Array
    low: Array
    high: Array
    running: Mask
    held_out: Mask


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """All that a diagnosis found.

    `sentence` is the verdict in words, `reasons` why it is none better, `untested` the effects that were off the
    table, by name with the reason. `material`: the held-out free run is further off than the floor by what could be
    felt; `traces` are the effects that are certain and are not; `absorbed` is the law that the model's own constants
    follow, if they follow one. `settings` holds seed, thresholds and noise, by name. `unit` is that of the followed
    variable: what is said to be in degC anywhere in a diagnosis is in it. `laws` are expressions to look at where the
    gap has no name, `floor` what a free run errs by where nothing is missing, `began` says since when it errs by more
    (None where that is from the first cycle on), `description` in the plant's words what goes best with a gap that has
    no name, "" where nothing does. `missing_heat` is the heat over time that the model lacks, `experiment`
    what would tell rivals apart, where it was asked for. `none_of_these` is the share that what is missing is none of
    the names, None where nothing is named.
    """

    verdict: Verdict
    sentence: str
    reasons: tuple[str, ...]
    effects: tuple[NamedEffect, ...]
    shifts: tuple[Shift, ...]
    places: tuple[HeatPlace, ...]
    unexplained: tuple[HeatPlace, ...]
    ceiling_before: Ceiling | None
    ceiling_after: Ceiling | None
    candidates: tuple[TriedEffect, ...]
    material: bool
    traces: tuple[TraceOfEffect, ...]
    absorbed: AbsorbedLaw | None
    untested: Mapping[str, str]
    held_out: HeldOutProof | None
    floor: NoiseFloor | None
    began: GapBeginning | None
    course: DiagnosisCourse | None
    settings: Mapping[str, float]
    model_before: str
    model_after: str | None
    unit: str = DEFAULT_UNIT
    laws: tuple[CandidateLaw, ...] = ()
    description: str = ""
    missing_heat: MissingHeat | None = None
    experiment: ProposedExperiment | None = None
    none_of_these: float | None = None
