"""From the path of names to a verdict: what may be said, what is withheld and why."""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.effects import moment_words
from sim.lab.discrepancy.diagnosis import Ceiling, HeldOutProof, NoiseFloor
from sim.lab.discrepancy.fitting import (
    CatalogueEntry,
    Fitted,
    Named,
    Record,
    automaton_effects,
    net_heat,
    on_sensor,
)
from sim.lab.discrepancy.gap import Excess, sensor_noise
from sim.lab.discrepancy.heat import HOUR_S
from sim.lab.discrepancy.held_out import HeldOutRun
from sim.lab.discrepancy.naming import EffectEvidence, NamingStep, likeness
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.discrepancy.screen import TIME_PARAMETERS, shortest_visible, smooth_course
from sim.sha import Array, display_unit

TOO_SMALL = "is certain, and too small to matter"
"""Why what is beyond chance is fitted along and gets no name."""


@dataclass(frozen=True, slots=True)
class NamingResult:
    """The path of names: each step with its verdict in words ("" where its best entry was taken), and the last fit.

    `nuisances` are steps whose best entry was too small to matter and was fitted along while the path went on; the
    last fit is without them.
    """

    base: Fitted
    fitted: Fitted
    steps: tuple[tuple[NamingStep, str], ...]
    nuisances: tuple[NamingStep, ...] = ()

    @property
    def looks(self) -> tuple[tuple[NamingStep, str], ...]:
        """The steps, and after them those of what was fitted along."""
        return (*self.steps, *((step, TOO_SMALL) for step in self.nuisances))

    @property
    def accepted_steps(self) -> tuple[NamingStep, ...]:
        """The steps whose best entry was taken."""
        return tuple(step for step, refusal in self.steps if not refusal)

    @property
    def best_fit(self) -> Fitted:
        """The fit with the best explanation that was found, whether or not it deserves a name."""
        step, refusal = self.steps[-1]
        best = step.best
        beyond_chance = best is not None and best.fitted is not None and best.gain >= step.rules.least_gain_nats
        return best.fitted if refusal and best is not None and best.fitted and beyond_chance else self.fitted


def insignificant(step: NamingStep, earlier: Sequence[NamingStep] = ()) -> str:
    """Why the best entry of a step is no more than chance, or a trifle; "" where something is missing.

    `earlier` are the steps whose best entries are in the model already.
    """
    best, rules = step.best, step.rules
    if best is None or not best.is_joint or best.gain < step.rules.least_gain_nats:
        gain = best.gain if best is not None else 0.0
        return f"adds {gain:.1f} nats, and a name needs {rules.least_gain_nats:.1f}"
    if immaterial(step):
        return TOO_SMALL
    # A further name must stand out of what the earlier ones' imperfect shapes leave behind, in degrees and in nats.
    before = max((other.best.amplitude for other in earlier if other.best is not None), default=0.0)
    if best.gain < rules.further_clear_nats and best.amplitude < rules.further_least_size_share * before:
        unit = display_unit(step.before.frame.record.model.unit)
        return f"moves the temperature by {best.amplitude:.3f} {unit}, no more than the shapes before may have left"
    needed, near = 0.0, rules.near_least_cosine
    least, most = rules.leftover_share, rules.leftover_of_rival_share
    for other in earlier:
        if other.best is not None:
            alike = max(likeness(other, best) - near, 0.0) / (1.0 - near)
            needed = max(needed, other.best.gain * (least + alike * (most - least)))
    if earlier and best.gain < max(step.rules.least_gain_nats + rules.further_nats, needed):
        return f"adds {best.gain:.1f} nats, no more than the effects before may have left behind"
    return ""


def immaterial(step: NamingStep) -> bool:
    """True where the best entry is beyond chance, yet moves the temperature by less than could be felt."""
    best = step.best
    if best is None or not best.is_joint or best.gain < step.rules.least_gain_nats:
        return False
    return best.amplitude < step.rules.material_sigmas * sensor_noise(step.before.frame.record)


def dubious(step: NamingStep) -> str:
    """Why the best entry of a step does not deserve its name though something is missing; "" where it does."""
    return contradiction(step) or refusal_reason(step)


def contradiction(step: NamingStep) -> str:
    """Why the fitted cycles do not agree about the best entry of a step; "" where they do, or cannot be asked."""
    best, rules = step.best, step.rules
    # Where the information lies in fewer than three cycles, single cycles cannot be asked to agree.
    if best is None or best.spread < rules.spread_least_cycles or best.gain >= rules.overwhelming_nats:
        return ""
    if abs(best.robust) < rules.robust_least_z:
        return f"rests on few cycles ({best.cycles[0]} of {best.cycles[1]} speak for it)"
    return "does not carry over from cycle to cycle" if best.carried <= 0 else ""


def refusal_reason(step: NamingStep) -> str:
    """Why the best entry of a step is no name, whatever the cycles say of it; "" where it is one."""
    best, rules = step.best, step.rules
    if best is None:
        return "there is nothing to name"
    if best.entry.rival:
        return "goes best with the data, and has no name"
    if step.margin < rules.margin_nats:
        return f"beats its rivals outside its class by {step.margin:.1f} nats only"
    return coincident(step) or unbelievable(step)


def coincident(step: NamingStep) -> str:
    """Why the best entry of a step may be whatever else happened when its signal moved, for once; "" where it moved
    more often, or where starts and stops show what acts late."""
    best = step.best
    if best is None or best.entry.kind.late is not None:
        return ""
    record = step.before.frame.record
    for signal in best.shape.signals.values():
        if (moment := only_move(record, signal, step.rules)) is not None:
            return (
                f"rests on the one time that {signal} moved while the machine ran, {moment_words(moment)}: whatever "
                "else was changed then explains as much"
            )
    return ""


def only_move(record: Record, signal: str, rules: DecisionRules) -> float | None:
    """When (absolute s) a signal moved that was at one level until then and at another afterwards, while the machine
    ran; None where it moved otherwise."""
    column, runs = record.window_means(record.signal(signal)), record.window_means(record.running) > 1.0 - 1e-9
    rows = runs & np.isfinite(column)
    column, times, n = column[rows], record.times[rows], int(rows.sum())
    centred = column - np.mean(column) if n > 1 else column
    whole = float(centred @ centred)
    if n < 2 or whole <= 0.0:
        return None
    count = np.arange(1, n)
    taken = np.cumsum(centred)[:-1] ** 2 * n / (count * (n - count))
    cut = int(np.argmax(taken)) + 1
    if taken[cut - 1] < rules.once_least_share * whole:
        return None
    # Back and forth for a short while, as an experiment has it, takes nothing of a step of days, and is no one move.
    before, after = np.median(column[:cut]), np.median(column[cut:])
    nearer = np.abs(column - after) < np.abs(column - before)
    held = nearer[1:][nearer[1:] == nearer[:-1]]
    return float(times[cut]) if np.count_nonzero(np.diff(held)) == 1 else None


def unbelievable(step: NamingStep) -> str:
    """Why the best entry of a step is nothing that a machine does, or that its rows show; "" where it may be."""
    best = step.best
    if best is None or best.fitted is None:
        return ""
    record = step.before.frame.record
    named, shortest = best.fitted.state.named[-1], shortest_visible(record)
    for time in (named.params[name] for name in TIME_PARAMETERS if name in named.params):
        if 0 < time < shortest:
            return f"lasts {_seconds(time)}, and nothing shorter than {_seconds(shortest)} is visible in these rows"
    most, fastest = greatest_heat(step.before, named), fastest_movement(step.before)
    if most > step.rules.most_heat_times * fastest:
        unit = display_unit(record.model.unit)
        return (
            f"would heat or cool by up to {most * HOUR_S:.3g} {unit}/h, and the fastest movement in these data is "
            f"{fastest * HOUR_S:.3g} {unit}/h"
        )
    return ""


def greatest_heat(fitted: Fitted, named: Named) -> float:
    """degC/s the greatest heat or cooling of an effect along the course of a fit; 0 of what acts on the reading."""
    record, smooth = fitted.frame.record, smooth_course(fitted)
    heating = [effect for effect in automaton_effects(named, record.model) if not on_sensor(effect)]
    return float(np.max(np.abs(net_heat(record, heating, smooth))))


def fastest_movement(fitted: Fitted) -> float:
    """degC/s the fastest movement of the temperature over a step of the record, without the sensor's noise."""
    runs = fitted.frame.record.runs
    moved, dt = np.abs(np.diff(smooth_course(fitted))), runs.dt[1:]
    steps = (dt > 0) & ~runs.first[1:]
    return float(np.max(moved[steps] / dt[steps])) if steps.any() else np.inf


def description(path: NamingResult) -> str:
    """What has no name and goes best with the data, in the plant's words; "" where there is no such thing."""
    best = path.steps[0][0].best if path.steps and not path.accepted_steps else None
    if best is None or best.fitted is None or not best.entry.rival or insignificant(path.steps[0][0]):
        return ""
    return " or ".join(_plant_words(each) for each in (best, *path.steps[0][0].alike))


def _plant_words(evidence: EffectEvidence) -> str:
    words, fitted = evidence.entry.candidate.words, evidence.fitted
    return words(fitted.state.named[-1].params) if words is not None and fitted is not None else evidence.entry.plain


def systematic(ceiling: Ceiling | None, rules: DecisionRules) -> bool:
    """True where a free learner predicts a share of the heat on unseen cycles that is no chance and no trifle."""
    known = ceiling is not None and ceiling.p <= rules.ceiling_most_p
    return known and ceiling is not None and ceiling.share >= rules.ceiling_least_share


def systematic_heat(ceiling: Ceiling | None) -> float:
    """(degC/h)^2 the mean square of the heat that a free learner predicts on unseen cycles."""
    return max(ceiling.share, 0.0) * ceiling.heat**2 if ceiling is not None else 0.0


def systematic_whole(before: Ceiling | None, left: Ceiling | None) -> float:
    """(degC/h)^2 all that was systematic, against which what names leave is held.

    What trees could predict before, or, where that is more, what the names themselves have taken out of the heat.
    """
    explained = before is not None and left is not None and before.heat > left.heat
    return max(systematic_heat(before), before.heat**2 - left.heat**2 if explained and before and left else 0.0)


def foreseen_better(first: HeldOutRun, second: HeldOutRun) -> float:
    """nats by which the second free run is nearer to the held-out cycles, both weighed by the second's noise.

    The first fit's own noise has swallowed what it could not explain; under it almost any error would be likely.
    """
    old, new = first.residual, second.residual
    weighed = second.whitener.weigh(np.column_stack([old, new]))
    return 0.5 * float(old @ weighed[:, 0] - new @ weighed[:, 1])


def doubts(
    path: NamingResult,
    first: HeldOutRun,
    *,
    second: HeldOutRun,
    held: HeldOutProof,
    before: Ceiling | None,
    left: Ceiling | None,
    shorter: HeldOutRun | None = None,
    given_is_nearer: bool = True,
) -> tuple[str, ...]:
    """Why names that the likelihood offers are not given after all; `first` and `second` are the held-out runs.

    `shorter` is the run without the last name, where there is more than one. `given_is_nearer`: where the model as it
    was given errs by less, it surely does (`surely_nearer`), and not by the chance of a few cycles.
    """
    if not path.accepted_steps:
        return ()
    reasons, rules = [], path.accepted_steps[0].rules
    if held.rmse_before <= held.noise_floor:
        reasons.append("the free run over the held-out cycles is no further off than noise alone: there is no gap")
    if shorter is not None and foreseen_better(shorter, second) <= 0:
        reasons.append("the held-out cycles are not better foreseen with the last name than without it")
    foreseen = foreseen_better(first, second)
    # Of a run that is no number nothing is better: every comparison is one that it fails.
    if not foreseen > 0:
        reasons.append("the held-out cycles are not better foreseen with it")
    if not held.rmse_after <= held.rmse_before:
        reasons.append("the free run over the held-out cycles is further off with it")
    elif given_is_nearer and is_noticeable(
        held.rmse_after, held.rmse_given, sensor_noise(path.base.frame.record), rules
    ):
        reasons.append("the free run over the held-out cycles is further off with it than the model as it was given")
    elif _hardly_smaller(path, held):
        reasons.append(f"it removes {held.excess_removed:.0%} of what the free run over the held-out cycles is off by")
    whole = systematic_whole(before, left)
    too_much = rules.ceiling_left_most_share * whole
    # What comes and goes within minutes is heat to a learner, and moves no temperature: not where the error is down to
    # what noise makes.
    covered = held.rmse_after <= held.noise_floor and min(foreseen, _gain(path)) >= rules.beyond_doubt_nats
    if not covered and left is not None and systematic(left, rules) and systematic_heat(left) > too_much:
        reasons.append(f"a free learner still predicts {left.share:.0%} of the heat on cycles that it has not seen")
    return tuple(reasons)


def _hardly_smaller(path: NamingResult, held: HeldOutProof) -> bool:
    """True where there is a held-out excess that could be felt, and nearly all of it is left."""
    removed, rules = held.excess_removed, path.accepted_steps[0].rules
    if removed is None or removed >= rules.removed_least_share:
        return False
    return matters(held, sensor_noise(path.base.frame.record), rules)


def uncertain_strengths(path: NamingResult) -> tuple[str, ...]:
    """Why names are withheld whose strength, beside all others, its own standard error does not tell from nothing."""
    if not path.accepted_steps:
        return ()
    reasons, least = [], path.accepted_steps[0].rules.strength_least_sigmas
    for name in (named.entry.name for named in path.fitted.state.named if named.existing is None):
        strength, error = path.fitted.strength(name)
        # An error that is no number tells nothing either.
        if not abs(strength) >= least * error:
            times = error / abs(strength) if strength else np.inf
            unsure = f"{times:.0%}" if times < 10.0 else "many times"  # an exponent is no word
            reasons.append(f"{name} is not told from nothing: its strength may be off by {unsure} of itself")
    return tuple(reasons)


def leftover_reasons(
    path: NamingResult, foreseen: float, before: Excess | None, after: Excess | None
) -> tuple[str, ...]:
    """Why names without a clear gain are withheld: the model's own noise did not cover its errors, nor does it now.

    `foreseen` are the nats by which held-out cycles are better foreseen with them.
    """
    if not path.accepted_steps or before is None or after is None or not before.wide(path.accepted_steps[0].rules):
        return ()
    rules = path.accepted_steps[0].rules
    if max(foreseen, _gain(path)) >= rules.beyond_doubt_nats or after.median < rules.covered_most_times:
        return ()
    return (f"with it the free run is still {after.median:.1f} times as far off as the model's own noise allows",)


def _gain(path: NamingResult) -> float:
    """nats of the names together."""
    return sum(step.best.gain for step in path.accepted_steps if step.best is not None)


def matters(held: HeldOutProof, sensor: float, rules: DecisionRules) -> bool:
    """True where the free run over the held-out cycles is further off than the floor by what could be felt.

    `sensor` (degC) is what one reading errs by.
    """
    return is_noticeable(held.rmse_before, held.noise_floor, sensor, rules)


def is_noticeable(error: float, other: float, sensor: float, rules: DecisionRules) -> bool:
    """True where an error (degC rms) is greater than another one by what could be felt."""
    return error**2 - other**2 >= (rules.material_sigmas * sensor) ** 2


def is_gap(held: HeldOutProof, floor: NoiseFloor, sensor: float, rules: DecisionRules) -> bool:
    """True where the held-out error is a gap: beyond what chance makes of the noise, and by what could be felt."""
    return held.rmse_before > floor.interval[1] and matters(held, sensor, rules)


def min_noticeable_error(readings: Array, sensor: float, rules: DecisionRules) -> float:
    """degC of an error that agreement must exclude in order to say anything: a share of what the temperature varies by,
    and at least what could be felt."""
    return max(rules.floor_blind_from_share * float(np.std(readings)), rules.material_sigmas * sensor)


def gap_evidence(
    path: NamingResult, before: Ceiling | None, beyond: Excess | None, *, covered: bool
) -> tuple[str, ...]:
    """What speaks for a gap to which no name was given, the strongest first; nothing where nothing does.

    `covered`: the held-out error is about what noise makes, so that the model's own noise says nothing against it.
    """
    step, refusal = path.steps[0]
    rules = step.rules
    if refusal and not insignificant(step):
        return (f"{description(path) or step.members[0]} {refusal}",)
    # No candidate stands for it: then the free learner's word alone, or the model's own noise (decision 0031).
    if systematic(before, rules) and before is not None and before.p <= rules.ceiling_alone_most_p:
        return ("a free learner predicts heat on cycles that it has not seen",)
    return (beyond.words(),) if beyond is not None and beyond.wide(rules) and not covered else ()


def beyond_chance(path: NamingResult, reasons: Sequence[str]) -> tuple[str, ...]:
    """What explains the fitted cycles beyond chance, where model and data agree all the same, and why it has no name;
    `reasons` are those against the names of the path. What is too small to matter is told as a trace."""
    step, refusal = path.steps[0]
    why = refusal or "; ".join(reasons)
    if step.best is None or not why or insignificant(step):
        return ()
    name, gain = step.members[0], step.best.gain
    return (f"{name} explains the fitted cycles better by {gain:.0f} nats, and is not named: {why}",)


def untested_effects(
    entries: Sequence[CatalogueEntry],
    present: Mapping[str, str],
    roles: Mapping[str, str],
    *,
    following: Container[str] = (),
    temperature: str = "",
) -> dict[str, str]:
    """The effects that were off the table, with the reason; `following` are the roles that follow the `temperature`."""
    out = {}
    for entry in entries:
        missing = [role for role in entry.needs if entry.role_key(role) not in present]
        if missing:
            signal = roles.get(entry.role_key(missing[0]), missing[0])
            role = entry.role_key(missing[0])
            if role in following:
                out[entry.name] = (
                    f"{roles[role]} ({role}) follows {temperature} in these traces: it is a consequence, and no cause"
                )
                continue
            out[entry.name] = f"needs {signal} ({missing[0]}), which these traces do not have or which never changes"
    return out


def too_short(entries: Sequence[CatalogueEntry], path: NamingResult) -> dict[str, str]:
    """The effects over some time of which no shape was looked for though their signals are there, with the reason."""
    tried = path.steps[0][0].tried
    shortest = shortest_visible(path.base.frame.record)
    timed = [entry for entry in entries if any(name in TIME_PARAMETERS for name in entry.kind.parameters)]
    reason = f"is looked for up to less than {_seconds(shortest)} only, and nothing shorter is visible in these rows"
    return {entry.name: reason for entry in timed if entry.name not in tried}


def _seconds(time: float) -> str:
    """A time (s) in words, without an exponent."""
    return f"{round(time, 1):g} s"
