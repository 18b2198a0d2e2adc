"""The search for candidate laws: scored on the fitted cycles, paid for by the number tried, judged on held-out cycles.

Everything is taken in the linear problem around the fit (as in `screen`): a law's heat goes through the plant's own
relaxation, what the model's parameters imitate is projected out, and its strength is the likeliest one. The likeliest
few are taken again with the noise fitted anew beside each. On the cycles that were held out nothing is fitted but where
each begins, so the nats by which they are foreseen better add to the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np

from sim.effects import SINCE, TEMPERATURE, LineError, compile_expression, names_in, own_kind, parse
from sim.lab.discrepancy.diagnosis import CandidateLaw
from sim.lab.discrepancy.fitting import (
    Fitted,
    NoiseModel,
    Record,
    Whitener,
    automaton_effects,
    heat_response,
    move_frame,
    net_heat,
    window_sensitivity,
    with_column,
)
from sim.lab.discrepancy.held_out import HeldOutRun, let_run
from sim.lab.discrepancy.law_family import (
    EVENT_RIVAL,
    LawColumns,
    LawForm,
    dated_rivals,
    family,
    law_columns,
    of_shapes,
    products,
    repeat_events,
    signal_names,
)
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.discrepancy.screen import Projector, Shape, alone, refine_shape, smooth_course
from sim.sha import Array, EffectLine, LineParameter

MOST, BEST = 3, 6
"""Laws that are shown at most, and forms of the first round that go into products."""
TRIED_LATER, OF_A_KIND = 8, 2
"""Laws that the held-out cycles are asked about at most, and those among them that differ in numbers alone."""
SHORTEST, LONGEST, RHYTHMS = 1200.0, 48 * 3600.0, 2
"""Seconds between which rhythms are looked for, and how many of them become expressions."""
CHUNK_FORMS = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class _ScoredForms:
    """Forms with their projected problem: `gain` (c,) nats, `strength` (c,), `columns` and `weighed` (m, c)."""

    forms: list[LawForm]
    gain: Array
    strength: Array
    columns: Array
    weighed: Array

    def concatenate(self, more: "_ScoredForms") -> "_ScoredForms":
        return _ScoredForms(
            forms=[*self.forms, *more.forms],
            gain=np.append(self.gain, more.gain),
            strength=np.append(self.strength, more.strength),
            columns=np.column_stack([self.columns, more.columns]),
            weighed=np.column_stack([self.weighed, more.weighed]),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _JudgedLaw:
    """A form by its `number`, with the `noise` beside it: nats on the cycles that were fitted and that are `foreseen`.

    `share` and `cycles` are those of `CandidateLaw`.
    """

    number: int
    noise: NoiseModel
    strength: float
    fitted: float
    foreseen: float
    share: float
    cycles: tuple[int, int]

    @property
    def gain(self) -> float:
        """nats in all: nothing was fitted to held-out cycles, so what they say adds to what the others do."""
        return self.fitted + self.foreseen

    def holds(self, tried: int, rules: DecisionRules) -> bool:
        """Whether it pays for all that were tried, and the held-out cycles agree."""
        better, cycles = self.cycles
        paid = self.gain - float(np.log(tried)) >= rules.law_least_nats
        return paid and self.share >= rules.law_least_share and better >= rules.law_least_cycles_share * cycles


def candidate_laws(
    base: Fitted, record: Record, fitted_until: int, floor: float, rules: DecisionRules, *, fitted_again: float = inf
) -> tuple[CandidateLaw, ...]:
    """At most three laws for what `base` leaves, the surest first; none where none holds on the held-out cycles.

    `record` has all that is measured, on the knots from which the fit's record was cut; cycles from `fitted_until` on
    are held out, but for those from `fitted_again` on. `floor` (degC) is the error that the given model allows itself.
    """
    held_out = (record.cycle >= fitted_until) & (record.cycle < fitted_again)
    training, later = record.select(~held_out), record.select(held_out)
    if not later.rows.size or training.runs.time.shape != base.frame.record.runs.time.shape:
        return ()
    fitted = replace(base, frame=move_frame(base.frame, training))
    names, begin = signal_names(fitted), float(training.runs.time[0])
    projector = Projector(fitted)
    periods, scanned = _rhythms(training.times, projector.weighed_residual)
    columns = law_columns(fitted, projector.smooth, names, begin, periods)
    by_date = dated_rivals(projector)
    scored = _score_forms(fitted, projector, columns, [*family(columns, training.running, begin), *by_date])
    best = [scored.forms[number] for number in np.argsort(-scored.gain, kind="stable")[:BEST].tolist()]
    scored = scored.concatenate(_score_forms(fitted, projector, columns, products(best, columns)))
    tried = len(scored.forms) + scanned

    trial = let_run(base, later.by_cycles())
    unseen = replace(
        base,
        frame=move_frame(base.frame, trial.record),
        state=trial.state,
        grid=trial.whitener.grid,
        residual=trial.residual,
    )
    there = law_columns(unseen, smooth_course(unseen), names, begin, periods)
    own = window_sensitivity(unseen.frame, trial.state, trial.record.reading[trial.record.window_first])
    chosen = _distinct(scored, rules)
    sharper = _sharpen_rivals(projector, scored, chosen)
    chosen += range(len(scored.forms), len(scored.forms) + len(sharper))
    scored = scored.concatenate(_score_forms(fitted, projector, columns, sharper))

    def judge_form(number: int) -> _JudgedLaw:
        form, column = scored.forms[number], scored.columns[:, number]
        # The noise was fitted without the law and has swallowed some of it: it is fitted anew beside it.
        beside, strength = with_column(fitted, column)
        # The model's own parameters make room for the law as a joint fit would let them.
        room = Projector(replace(fitted, noise=beside.noise))
        moved = room.made_room(strength * column) - room.made_room(np.zeros_like(column))
        unit = _reading(unseen, there, [form])[:, 0]
        after = trial.residual - strength * unit - own[:, : moved.size] @ moved
        share, better, cycles = _held_out_score(trial, after, floor)
        return _JudgedLaw(
            number=number,
            noise=beside.noise,
            strength=strength,
            fitted=beside.likelihood - fitted.likelihood,
            foreseen=_foreseen(trial, after, beside.noise),
            share=share,
            cycles=(better, cycles),
        )

    laws = [judge_form(number) for number in chosen]
    events = [
        law
        for law in laws
        if scored.forms[law.number].kind == EVENT_RIVAL and law.fitted >= rules.law_fitted_least_nats
    ]
    if events:
        # What was done once may have been done twice; the second time is looked for beside the first.
        first = max(events, key=lambda law: law.fitted)
        with_first = Projector(replace(fitted, noise=first.noise))
        again = _score_forms(fitted, with_first, columns, repeat_events(scored.forms[first.number], by_date))
        scored = scored.concatenate(again)
        laws += [judge_form(len(scored.forms) - len(again.forms) + int(np.argmax(again.gain)))] if again.forms else []
    found = [
        law for law in laws if law.holds(tried, rules) and (law.strength > 0 or not scored.forms[law.number].exchange)
    ]
    surest: dict[str, _JudgedLaw] = {}
    for law in sorted(found, key=lambda law: rules.law_term_nats * scored.forms[law.number].terms - law.gain):
        # Of laws that differ in their numbers alone (a date, a time) the surest is the law.
        surest.setdefault(scored.forms[law.number].kind, law)
    most = max((law.gain for law in found), default=0.0)
    told = [law for law in surest.values() if law.gain >= rules.law_further_least_share * most][:MOST]
    return tuple(
        _describe_law(scored, law, names, tried, place=place, rules=rules) for place, law in enumerate(told, start=1)
    )


def _describe_law(
    scored: _ScoredForms, law: _JudgedLaw, names: dict[str, str], tried: int, *, place: int, rules: DecisionRules
) -> CandidateLaw:
    form = scored.forms[law.number]
    return CandidateLaw(
        expression=form.text,
        words=form.said(law.strength),
        running=form.running,
        strength=law.strength,
        gain=law.gain,
        share=law.share,
        cycles=law.cycles,
        tried=tried,
        experiment=form.experiment,
        alike=_similar_laws(scored, law.number, rules),
        line=_line(form, names, law.strength, place),
    )


def _sharpen_rivals(projector: Projector, scored: _ScoredForms, chosen: Sequence[int]) -> list[LawForm]:
    """Those of the chosen forms that are rivals', with their dates and times where the gain is greatest.

    A date that is driven to an end of the record is none.
    """
    sharper, clock = [], projector.fitted.frame.record.runs.time
    ends = {float(clock[0]), float(clock[-1])}
    for number in (each for each in chosen if scored.forms[each].shapes):
        (shape,) = scored.forms[number].shapes
        if shape.entry.candidate.refine:
            params = refine_shape(projector, shape, float(scored.strength[number])).params
            if any(params[name] in ends and params[name] != value for name, value in shape.params.items()):
                continue
            shape = Shape(shape.entry, shape.signals, {name: params[name] for name in shape.params})
            sharper.append(of_shapes((shape,)))
    return sharper


def _rhythms(times: Array, score: Array) -> tuple[list[float], int]:
    """(the periods (s) that the score of the residual goes with most, how many were looked at)."""
    # A periodogram, twice as fine as the record's length tells periods apart; neighbours of a peak are its own.
    length = float(times[-1] - times[0])
    frequencies = np.arange(1.0 / min(LONGEST, length), 1.0 / SHORTEST, 0.5 / length)
    clock = times - times[0]
    power = np.array([np.abs(np.sum(score * np.exp(-2j * np.pi * each * clock))) * each**-1 for each in frequencies])
    periods: list[float] = []
    for number in np.argsort(-power, kind="stable").tolist():
        if all(abs(frequencies[number] - 1.0 / period) > 2.0 / length for period in periods):
            periods.append(1.0 / float(frequencies[number]))
        if len(periods) == RHYTHMS:
            break
    return periods, 2 * frequencies.size


def _heat(fitted: Fitted, columns: LawColumns, form: LawForm) -> Array:
    """(n,) degC/s the heat of a form at unit strength."""
    record, smooth = fitted.frame.record, columns.values[TEMPERATURE]
    running = record.running
    if not form.shapes:
        heat = np.broadcast_to(compile_expression(parse(form.text))(columns.values), running.shape)
        return np.asarray(np.where(np.isfinite(heat), heat, 0.0) * (running if form.running else 1.0))
    effects = [effect for shape in form.shapes for effect in automaton_effects(shape.with_strength(1.0), record.model)]
    return net_heat(record, effects, smooth)


def _reading(fitted: Fitted, columns: LawColumns, forms: Sequence[LawForm]) -> Array:
    """(m, c) degC what the heats of forms do to the windows."""
    added = heat_response(fitted.frame, fitted.state)
    return np.column_stack([added(_heat(fitted, columns, form)) for form in forms])


def _score_forms(fitted: Fitted, projector: Projector, columns: LawColumns, forms: list[LawForm]) -> _ScoredForms:
    gains, strengths, kept, weights = [], [], [], []
    for begin in range(0, len(forms), CHUNK_FORMS):
        part = forms[begin : begin + CHUNK_FORMS]
        made = _reading(fitted, columns, part)
        gain, strength, weighed = alone(projector, made, np.array([float(form.exchange) for form in part]))
        gains.append(gain)
        strengths.append(strength)
        kept.append(made)
        weights.append(weighed)
    empty = np.empty((fitted.residual.size, 0))
    return _ScoredForms(
        forms=forms,
        gain=np.concatenate([np.empty(0), *gains]),
        strength=np.concatenate([np.empty(0), *strengths]),
        columns=np.column_stack([empty, *kept]),
        weighed=np.column_stack([empty, *weights]),
    )


def _cosines(scored: _ScoredForms, number: int) -> Array:
    """(c,) cosine of each form with one of them, in the product that the noise gives."""
    sizes = np.sqrt(np.maximum(np.einsum("ij,ij->j", scored.columns, scored.weighed), 1e-300))
    return np.asarray(scored.weighed.T @ scored.columns[:, number] / (sizes * sizes[number]))


def _distinct(scored: _ScoredForms, rules: DecisionRules) -> list[int]:
    """The surest forms that these data can tell apart: each the simplest of its kind, few of one kind."""
    terms = np.array([form.terms for form in scored.forms], dtype=float)
    kinds = np.array([form.kind for form in scored.forms])
    # Among forms that say the same the simpler one is taken.
    left = np.where(scored.gain >= rules.law_fitted_least_nats, scored.gain - rules.law_term_nats * terms, -np.inf)
    chosen: list[int] = []
    while len(chosen) < TRIED_LATER and np.isfinite(left).any():
        number = int(np.argmax(left))
        chosen.append(number)
        text = scored.forms[number].text
        # What only adds a factor to a surer law says nothing new.
        contained = np.array([text in form.text for form in scored.forms])
        same = contained | (np.abs(_cosines(scored, number)) >= rules.law_same_least_cosine)
        if int(np.count_nonzero(kinds[chosen] == kinds[number])) >= OF_A_KIND:
            same |= kinds == kinds[number]
        left = np.where(same, -np.inf, left)
    return chosen


def _similar_laws(scored: _ScoredForms, number: int, rules: DecisionRules) -> tuple[str, ...]:
    """Other laws that these data cannot tell from one, within a tenth of its gain, three at most."""
    near = np.abs(_cosines(scored, number)) >= rules.law_same_least_cosine
    near &= scored.gain >= 0.9 * scored.gain[number]
    order = [other for other in np.argsort(-scored.gain, kind="stable").tolist() if near[other] and other != number]
    form = scored.forms[number]
    others = [
        other for other in order if scored.forms[other].kind != form.kind and form.text not in scored.forms[other].text
    ]
    return tuple(dict.fromkeys(scored.forms[other].said(float(scored.strength[other])) for other in others))[:3]


def _held_out_score(trial: HeldOutRun, after: Array, floor: float) -> tuple[float, int, int]:
    """(share of the error above the floor that is gone, pieces that are better foreseen, pieces)."""
    pieces = np.unique(trial.record.window_cycle, return_inverse=True)[1]
    old, new = np.bincount(pieces, trial.residual**2), np.bincount(pieces, trial.restart_residual(after) ** 2)
    counts = np.bincount(pieces)
    excess = float(np.sum(old) - floor**2 * np.sum(counts))
    share = float(np.sum(old) - np.sum(new)) / excess if excess > 0 else 0.0
    return min(share, 1.0), int(np.count_nonzero(new < old)), int(counts.size)


def _foreseen(trial: HeldOutRun, after: Array, noise: NoiseModel) -> float:
    """nats by which residuals `after` a law are likelier than those before on the held-out cycles, under one noise."""
    old, new = trial.restart_residual(trial.residual), trial.restart_residual(after)
    weighed = Whitener(trial.whitener.grid, noise).weigh(np.column_stack([old, new]))
    return 0.5 * float(old @ weighed[:, 0] - new @ weighed[:, 1])


def _line(form: LawForm, names: dict[str, str], strength: float, number: int) -> EffectLine | None:
    """The law as an engineer's line; None where no engine can execute it (a lag, a rhythm, a clock, a date)."""
    if form.shapes:
        return None
    read = names_in(parse(form.text))
    if any(name not in (*names, TEMPERATURE, SINCE) for name in read):
        return None
    low, high = (0.0, inf) if strength > 0 else (-inf, 0.0)
    line = EffectLine(
        name=f"law-{number}",
        heat=f"gain * ({form.text})",
        meaning=f"heat that goes with {form.text}",
        strength="gain",
        experiment=form.experiment,
        acts="running" if form.running else "anywhere",
        signals=tuple((name, names[name]) for name in read if name in names),
        parameters=(LineParameter(name="gain", unit="degC/s for each unit of the law", low=low, high=high),),
    )
    try:
        own_kind(line)
    except LineError:
        return None
    return line
