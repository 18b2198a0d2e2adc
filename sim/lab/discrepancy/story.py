"""A diagnosis told: its sentence, its places without a cause, and the courses that the pictures show."""

from collections.abc import Sequence

import numpy as np

from sim.effects import moment_words
from sim.lab.discrepancy.advice import shown_move, told_places
from sim.lab.discrepancy.diagnosis import (
    AbsorbedLaw,
    Diagnosis,
    DiagnosisCourse,
    GapBeginning,
    HeatPlace,
    HeldOutProof,
    NamedEffect,
    NoiseFloor,
    Shift,
    TraceOfEffect,
    Verdict,
)
from sim.lab.discrepancy.fitting import Fitted, Record
from sim.lab.discrepancy.heat import HOUR_S, implied_heat, since_switch
from sim.lab.discrepancy.held_out import HeldOutRun
from sim.lab.discrepancy.rules import RULES
from sim.sha import Array, display_unit

MIN_SHOWN_SHARE = 0.01
"""Shares below it are said to be."""


def verdict_sentence(
    verdict: Verdict,
    effects: Sequence[NamedEffect],
    *,
    unexplained: Sequence[HeatPlace],
    shifts: Sequence[Shift],
    held: HeldOutProof | None,
    cycles: int,
    traces: Sequence[TraceOfEffect] = (),
    law: AbsorbedLaw | None = None,
    description: str = "",
    unit: str,
    began: GapBeginning | None = None,
    gap: bool = True,
    little: str = "",
    none_of_these: float | None = None,
    still: str = "",
) -> str:
    """The verdict in one or two sentences; errors are in `unit`, as people read it.

    `gap`: over the held-out cycles the free run is further off than chance makes of the noise. `little`: why that it is
    not says nothing (`little_sentence`). `none_of_these`: how likely what is missing is none of the effects.
    """
    if verdict == "too-little-data" and not little:
        return f"Too little data: {cycles} cycle{'s' if cycles != 1 else ''} cannot tell an effect from chance."
    moved = f" {still}" if still else ""
    if shifts:
        surest = shifts[0]
        moved += (
            f" Parameters have moved: {surest.parameter} in {surest.location} {shown_move(surest)}, "
            f"{abs(surest.sigma):.0f} sigma."
        )
    if law is not None:
        moved += (
            f" The model's {law.constants} constants follow one law, {law.words} ({law.name}): {law.instead} numbers "
            f"stand for them, the held-out error goes from {law.rmse_before:.3g} to {law.rmse_after:.3g} {unit}."
        )
    if held is not None and held.rmse_refit is not None:
        moved += (
            f" With its parameters refitted the model is further off on cycles that were never fitted "
            f"({held.rmse_refit:.3g} against {held.rmse_given:.3g} {unit}): they stay as given."
        )
    if verdict == "too-little-data":
        return little + moved
    if verdict == "agree":
        trace = "".join(
            f" A trace of {each.name} moves the temperature by {each.moves:.2g} {unit}, less than could be felt."
            for each in traces
        )
        return "Model and data agree within noise." + trace + moved
    since = "" if began is None else f" {beginning_sentence(began, unit)}"
    gain = ""
    if held is not None and effects:
        gain = (
            f" On {_count(held.cycles, 'cycle')} that {'was' if held.cycles == 1 else 'were'} never fitted the error "
            f"goes from {held.rmse_before:.2f} to {held.rmse_after:.2f} {unit} (noise alone: {held.noise_floor:.2f})."
        )
        gain += "" if all(each.shrinking_shown for each in effects) else " The shrinking is not shown."
    if verdict == "named":
        names = " and ".join(f"{effect.name} ({effect.plain}), {effect.confidence:.2f}" for effect in effects)
        return f"Missing in the model: {names}{none_words(none_of_these)}.{since}{gain}{moved}"
    if verdict == "class":
        names = "; ".join(f"{' or '.join(effect.members)}, {effect.confidence:.2f}" for effect in effects)
        names += none_words(none_of_these)
        return f"Something is missing that these data cannot tell apart: {names}.{since}{gain}{moved}"
    where = "the free run is further off than noise allows, in no particular place."
    if not gap:
        where = (
            "the fitted cycles show it, in no particular place; on the others the free run is off by what noise allows."
        )
    if description:
        where = f"{description}."
    if told := told_places(unexplained):
        place = told[0]
        low, high = place.seconds
        seconds = f"{low:.0f}-{high:.0f} s" if np.isfinite(high) else f"more than {low:.0f} s"
        goes = f", and goes with {place.correlates}" if place.correlates else ""
        goes = f", with {place.when}" if place.when else goes
        where = f"{description}; " if description else ""
        where += (
            f"{place.share:.0%} of the unexplained heat is in {place.location}, {seconds} after "
            f"{place.after or 'its beginning'}{goes} ({place.cycles[0]} of {place.cycles[1]} cycles)."
        )
    return f"Something is missing that has no honest name: {where}{since}{moved}"


def little_sentence(floor: NoiseFloor, held: HeldOutProof, varies: float, least: float, unit: str) -> str:
    """Why agreement says nothing where the temperature `varies` by so much (rms) and an error of `least` would have to
    be seen, and what would be needed; both degC, `unit` as people read it."""
    said = (
        f"Too little data: over {_count(held.cycles, 'cycle')} that {'was' if held.cycles == 1 else 'were'} never "
        f"fitted the free run may be off by {floor.interval[1]:.3g} {unit} by chance alone, and all that the "
        f"temperature varies by is {varies:.3g} {unit} (rms): that it agrees would say nothing."
    )
    if floor.error >= least:
        return (
            f"{said} More of the same would not help, since noise alone makes {floor.error:.3g} {unit}: record what "
            "heats and cools the machine (its load, the room)."
        )
    # What chance adds to the floor goes with one over the root of the data.
    times = ((floor.interval[1] - floor.error) / (least - floor.error)) ** 2
    return f"{said} About {np.ceil(times):.0f} times as much of it is needed."


def still_sentence(temperature: str, readings: Array, unit: str) -> str:
    """Why a temperature that never moves says nothing; `unit` as people read it."""
    return (
        f"Too little data: each of the {readings.size} readings of {temperature} is {readings[0]:.6g} {unit}. What "
        "never changes tells nothing of the machine: look at its sensor."
    )


def none_words(share: float | None) -> str:
    """How likely what is missing is none of the names, as the end of a sentence; "" where nothing is named."""
    if share is None:
        return ""
    return f"; none of these {share:.2f}" if share >= MIN_SHOWN_SHARE else f"; none of these below {MIN_SHOWN_SHARE}"


def beginning_sentence(began: GapBeginning, unit: str) -> str:
    """Since when the machine is warmer or cooler than before, and how sure the date is; `unit` as people read it."""
    low, moment, high = (moment_words(time) for time in (began.interval[0], began.time, began.interval[1]))
    how = "while it runs" if began.running else "at rest"
    what, count = "cycle", "cycles"
    if began.stretch:
        what, count = "stretch", f"stretches of {shown_span(began.stretch)}"
    more = "" if began.then is None else f", and from {moment_words(began.then[0])} on {_warmer(began.then[1], unit)}"
    like = f", most like {began.acts}" if began.acts else ""
    return (
        f"It begins with the {what} of {moment} (between {low} and {high}): since then the machine is "
        f"{_warmer(began.moves, unit)} {how} than before{like}{more} "
        f"({began.before} {count} before, {began.after} after)."
    )


def beginning_reason(began: GapBeginning, unit: str) -> str:
    """Why a beginning is a gap, whatever the held-out cycles say; `unit` as people read it."""
    how, size = "while the machine runs" if began.running else "at rest", f"{abs(began.moves):.2g} {unit}"
    if began.acts:
        since = f"{began.acts} from {moment_words(began.time)} on"
        return f"{since} explains more than anything that acts all along (p = {began.p:.1g})"
    return f"from {moment_words(began.time)} on the free run errs by {size} more {how} (p = {began.p:.1g})"


def _warmer(moves: float, unit: str) -> str:
    return f"{abs(moves):.2g} {unit} {'warmer' if moves > 0 else 'cooler'}"


def shown_span(seconds: float) -> str:
    """A time in hours, or in minutes where it is shorter, as people read it."""
    return f"{seconds / 3600:.2g} hours" if seconds >= 3600 else f"{seconds / 60:.2g} minutes"


def held_out_sentence(diagnosis: Diagnosis) -> str:
    """What the held-out cycles show: the error as given, refitted and with what was added, the floor, what is gone.

    "" where nothing was held out.
    """
    held, unit = diagnosis.held_out, display_unit(diagnosis.unit)
    if held is None:
        return ""
    errors = f"{held.rmse_given:.3f} {unit} as given, {held.rmse_before:.3f} {unit} refitted"
    if held.rmse_refit is not None:
        errors = f"{held.rmse_given:.3f} {unit} as given, {held.rmse_refit:.3f} {unit} refitted, which is refused"
    if diagnosis.effects:
        errors += f", {held.rmse_after:.3f} {unit} with what was added"
    parts = (
        f"{held_out_count(held)}, free-run error {errors}",
        "" if diagnosis.floor is None else floor_sentence(diagnosis.floor, unit),
        removed_sentence(held, diagnosis.effects),
    )
    return "; ".join(part for part in parts if part)


def held_out_count(held: HeldOutProof) -> str:
    """How many cycles were held out, and how many pieces of evidence they are where these are others."""
    pieces = "" if held.pieces == held.cycles else f" in {_count(held.pieces, 'independent piece')}"
    return _count(held.cycles, "cycle") + pieces


def floor_sentence(floor: NoiseFloor, unit: str) -> str:
    """The noise floor with its interval, and what it was told from; `unit` as people read it."""
    low, high = floor.interval
    share = f"{100 * RULES.floor_interval_share:.0f} % interval"
    return f"noise floor {floor.error:.3f} {unit} ({share} {low:.3f} to {high:.3f}), from {floor.source}"


def removed_sentence(held: HeldOutProof, effects: Sequence[NamedEffect]) -> str:
    """How much of the held-out excess is gone with the effects, with its interval; "" where nothing was added."""
    if not effects:
        return ""
    if held.excess_removed is None or held.ci95 is None:
        return "no excess over the floor that could have been removed: the shrinking is not shown"
    low, high = held.ci95
    share = f"{held.excess_removed:.0%}"
    gone = "all of the excess removed, to within the floor" if share == "100%" else f"{share} of the excess removed"
    shown = "" if all(each.shrinking_shown for each in effects) else ": the shrinking is not shown"
    return f"{gone} (95 % interval {low:.0%} to {high:.0%}){shown}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def diagnosis_course(base: Fitted, after: Fitted, before_trial: HeldOutRun, after_trial: HeldOutRun) -> DiagnosisCourse:
    """Readings and free runs over the fitted and the held-out windows, with the heat that each model leaves."""
    record, later = base.frame.record, before_trial.record
    names = [location.name for location in record.model.sha.locations]

    def both(first: Array, second: Array) -> Array:
        return np.concatenate([first, second])

    heat_before, heat_after = (
        np.concatenate([implied_heat(fitted) * HOUR_S, np.full(later.times.size, np.nan)]) for fitted in (base, after)
    )
    return DiagnosisCourse(
        times=both(record.times, later.times),
        reading=both(record.reading, later.reading),
        before=both(record.reading - base.turn_residual, later.reading - before_trial.residual),
        after=both(record.reading - after.turn_residual, later.reading - after_trial.residual),
        held_out=both(np.zeros(record.times.size), np.ones(later.times.size)),
        heat_before=heat_before,
        heat_after=heat_after,
        location=tuple(names[place] for place in np.concatenate([_places(record), _places(later)]).tolist()),
        since_event=both(_phase_seconds(record), _phase_seconds(later)),
        cycle=both(record.window_whole.astype(float), later.window_whole.astype(float)),
    )


def _places(record: Record) -> Array:
    return np.asarray(record.runs.place[record.rows[record.begins]])


def _phase_seconds(record: Record) -> Array:
    return record.window_means(since_switch(record))
