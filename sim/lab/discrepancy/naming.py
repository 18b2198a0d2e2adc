"""One step towards a name: the catalogue screened, the likeliest confirmed by joint refits and weighed."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
import scipy

from sim.effects import CHANGES_AT_A_MOMENT, SECOND_MOMENT, UNMEASURED_NEIGHBOUR
from sim.lab.discrepancy.fitting import (
    CatalogueEntry,
    Fitted,
    Named,
    automaton_effects,
    catalogue,
    fit,
    follows_course,
    restore_fit,
    rivals,
    slim,
    with_heats,
    without_last,
)
from sim.lab.discrepancy.rules import DecisionRules
from sim.lab.discrepancy.screen import (
    Projector,
    Screen,
    Shape,
    quieter,
    refine_shape,
    screen,
    screen_shapes,
    shape_columns,
)
from sim.lab.discrepancy.unmeasured import gain_at_once, slow_heat
from sim.sha import Array, Effect

CONFIRMED, WORTH = 4, 1.0
"""Entries that are confirmed at most, and the screen's gain (nats) from which it is worth while."""
PROMISED_TIMES, PROMISED_TIMES_OF_COURSE = 4.5, 25.0
"""Times the screen's gain that a refit is likelier by at most: the noise has swallowed a part of what is missing, and
gives it back. Of 64 refits the most was 3.5 times; and of 10 of what follows the temperature itself, as a valve does,
12.3 times: what it does along the readings is not what it does along its own course."""
ONE_CHAIN = frozenset({"dead-time", "sensor-lag", "late-current-heating"})
"""What lies between what is done and the reading is named once: a second name would mend the first one's shape."""
EXTRA_CONFIRMED = 2
"""Entries that would lead under less scatter of cycles, which are confirmed as well."""
TWINS_OF_LOSS = frozenset({"less-cooling", "other-surroundings"})
"""What is lost to the surroundings is less in both, from a moment on; a lower loss makes the machine slower, too."""
LOOKED_AGAIN_SHARE = 0.5
"""Of the best gain, that of a change at a moment from which on such changes are looked for again where it has led."""
CONFIRM_ROUNDS = 3
"""Rounds of a refit that confirms."""
HOPELESS_NATS = 50.0
"""By which a refit is less likely than the fit without its effect where nobody waits for it to settle."""
NEIGHBOUR_RIVALS = 2
"""The likeliest of the others that an unmeasured neighbour is held against together."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectEvidence:
    """An entry against what a fit leaves: its best shape, its gain (nats), and the joint refit where there was one,
    which is `slim` but for the best of a step.

    `visible`, `z`, `robust` and `cycles` are those of `diagnosis.TriedEffect`. `spread` is over how many cycles its
    information is spread, `carried` the gain (nats, linearised) when each cycle's strength is that of the others.
    `amplitude` is its rms (degC) beyond what the parameters imitate.
    """

    entry: CatalogueEntry
    shape: Shape
    gain: float
    visible: float
    z: float
    robust: float
    cycles: tuple[int, int]
    spread: float
    carried: float
    amplitude: float
    fitted: Fitted | None

    @property
    def is_joint(self) -> bool:
        """True when the gain is that of the joint refit."""
        return self.fitted is not None


@dataclass(frozen=True, slots=True)
class NamingStep:
    """A step from a fit: the evidence of every entry with its signals, best first; cosines; the rules.

    `cosines` gives, for the best entry, the cosine of each other entry's effect with its own, the model's parameters
    projected out of both. `rules` are those that it was made by and is judged by. `rivals` are the gains (nats) of what
    has no name, also where it is left out of the evidence since it does no better than the names. `tried` are all
    entries of which a shape was looked for.
    """

    before: Fitted
    evidence: tuple[EffectEvidence, ...]
    cosines: Mapping[str, float]
    rules: DecisionRules
    rivals: Mapping[str, float] = field(default_factory=dict)
    tried: frozenset[str] = frozenset()

    @property
    def best(self) -> EffectEvidence | None:
        """The entry of the greatest gain."""
        return self.evidence[0] if self.evidence else None

    @property
    def members(self) -> tuple[str, ...]:
        """The best entry's name and those of its class that do not lie a whole margin behind it."""
        if self.best is None:
            return ()
        top, same = self.best.gain, self.rules.same_least_cosine
        twins = [twin for twin in self.evidence[1:] if abs(self.cosines.get(twin.entry.name, 0.0)) >= same]
        near = (twin.entry.name for twin in twins if top - twin.gain < margin_of_class(top, self.rules))
        return (self.best.entry.name, *near)

    @property
    def alike(self) -> tuple[EffectEvidence, ...]:
        """What else from a moment on, without a name as the best is, explains as much as that, to within the margin."""
        if self.best is None or not self.best.entry.rival:
            return ()
        near = self.best.gain - margin_of_class(self.best.gain, self.rules)
        return tuple(each for each in self.evidence[1:] if each.gain > near and _are_twins(self.best, each))

    @property
    def margin(self) -> float:
        """Nats by which the best beats every entry outside its members."""
        if self.best is None:
            return 0.0
        others = [rival.gain for rival in self.evidence[1:] if rival.entry.name not in self.members]
        return self.best.gain - max(others, default=0.0)


def step(
    before: Fitted,
    entries: Sequence[CatalogueEntry],
    roles: Mapping[str, str],
    told: Callable[[str], None] = lambda _: None,
    *,
    rules: DecisionRules,
) -> NamingStep:
    """Screen and confirm `entries` on top of a fit; each that is fitted is `told` by its name before."""
    screened, quiet = screen(before, entries, roles)
    evidence = [_evidence(screened, number) for number in screened.best().values()]
    # The screen orders well but judges too low (its noise has swallowed a part of the effect): the first few are fitted
    # jointly, and only a gain of a joint refit can become a name.
    # So are rivals that would be among them; they take no name's place.
    names = [each for each in evidence if not each.entry.rival]
    first = {each.entry.name for each in (*names[:CONFIRMED], *first_kinds(evidence))}
    likely = [each for each in evidence if each.entry.name in first and each.gain >= WORTH]
    confirmed = list[EffectEvidence]()
    for each in likely:
        if not _falls_short(each, before, confirmed, rules):
            told(each.entry.name)
            confirmed = _slim_but_best([*confirmed, confirm(before, each)])
    # What would lead if the cycles scattered less is fitted too, and what it is a special case of: it may be what they
    # differ by. The joint fit decides.
    differing = [_evidence(quiet, number) for number in quiet.best().values()]
    leading = {each.entry.name for each in differing[:EXTRA_CONFIRMED]}
    done = {each.entry.name for each in confirmed}
    wider = [
        each
        for each in differing[EXTRA_CONFIRMED:]
        if each.entry.name not in done and leading & {*each.entry.candidate.special}
    ]
    fitted_shapes = {each.entry.name: each.shape for each in likely if each.entry.name in done}
    for each in (*differing[:EXTRA_CONFIRMED], *wider):
        # A refit from the very shape ends where the one before did, whatever scatter it begins with.
        repeated = fitted_shapes.get(each.entry.name) == each.shape
        if each.gain >= WORTH and not repeated and not _falls_short(each, before, confirmed, rules):
            told(each.entry.name)
            confirmed = _slim_but_best(_replace_evidence(confirmed, confirm(quieter(before), each)))
    # What could win is weighed against its special cases: they are fitted too, wherever the screen has them.
    top = max((each.gain for each in confirmed), default=0.0)
    near = top - margin_of_class(top, rules)
    special = {name for each in confirmed if each.gain >= near for name in each.entry.candidate.special}
    for each in names:
        done = {own.entry.name for own in confirmed}
        if each.entry.name in special - done and each.gain >= WORTH:
            confirmed = _slim_but_best([*confirmed, confirm(before, each)])
    for each in (
        *twice_from_once(before, screened.shapes, confirmed, rules, told),
        *changes_at_a_moment(before, screened.shapes, confirmed, rules, told),
    ):
        confirmed = _slim_but_best(_replace_evidence(confirmed, each))
    done = {each.entry.name for each in confirmed}
    rest = [other for other in evidence if other.entry.name not in done]
    everything = [*confirmed, *rest, *_neighbour_evidence(before, confirmed, entries, rules.least_gain_nats)]
    order = tuple(sorted(without_idle(everything, rules), key=lambda each: -each.gain))
    if order and order[0].fitted is not None:
        order = (replace(order[0], fitted=restore_fit(order[0].fitted)), *order[1:])
    nameless = {each.entry.name: each.gain for each in everything if each.entry.rival}
    tried = frozenset(each.entry.name for each in everything)
    return NamingStep(before, order, _cosines(before, order), rules, nameless, tried)


def _falls_short(
    each: EffectEvidence, before: Fitted, confirmed: Sequence[EffectEvidence], rules: DecisionRules
) -> bool:
    """Whether a refit could change nothing: beside names it would be no further one, and it would not come near the
    best that was `confirmed`."""
    effects = automaton_effects(each.shape.with_strength(1.0), before.frame.record.model)
    follows = any(follows_course(effect) for effect in effects)
    beside = any(named.existing is None for named in before.state.named)
    needed = rules.least_gain_nats + rules.further_nats if beside else 0.0
    top = max((other.gain for other in confirmed), default=0.0)
    promised = each.gain * (PROMISED_TIMES_OF_COURSE if follows else PROMISED_TIMES)
    return promised < max(needed, LOOKED_AGAIN_SHARE * top)


def first_kinds(evidence: Sequence[EffectEvidence]) -> list[EffectEvidence]:
    """The first of the evidence, of so many kinds as are confirmed: what changes at a moment is one, as it looks alike
    and would leave no room."""
    first, kinds = list[EffectEvidence](), set[str]()
    for each in evidence:
        kinds.add("" if each.entry.name in CHANGES_AT_A_MOMENT else each.entry.name)
        if len(kinds) > CONFIRMED:
            break
        first.append(each)
    return first


def twice_from_once(
    before: Fitted,
    shapes: Sequence[Shape],
    confirmed: Sequence[EffectEvidence],
    rules: DecisionRules,
    told: Callable[[str], None],
) -> Iterator[EffectEvidence]:
    """The refits of what came twice, looked for from the refit of the same that came once, where that explains much.

    Of two moments that are looked for together there are too many pairs for a fine grid; from the first one's refit the
    second stands out, at any of the moments of a single one. Within the width over which a moment is looked for it is
    the same change, which took its time.
    """
    top = max((each.gain for each in confirmed), default=0.0)
    wider = {shape.entry.name: shape.entry for shape in shapes if SECOND_MOMENT in shape.params}
    for once in confirmed:
        if once.fitted is None or once.gain < max(rules.least_gain_nats, LOOKED_AGAIN_SHARE * top):
            continue
        for entry in (each for each in wider.values() if once.entry.name in each.candidate.special):
            apart = entry.candidate.widths[SECOND_MOMENT]
            moments = {shape.params["at"] for shape in shapes if shape.entry.name == once.entry.name}
            some = tuple(
                Shape(entry, once.shape.signals, {**once.shape.params, SECOND_MOMENT: each})
                for each in sorted(moments)
                if abs(each - once.shape.params["at"]) > apart
            )
            if not some:
                continue
            told(entry.name)
            around = without_last(once.fitted)
            projector = Projector(around)
            again = screen_shapes(projector, some, shape_columns(projector, some))
            twice = confirm(before, _evidence(again, int(np.argmax(again.gain))), around)
            if abs(twice.shape.params[SECOND_MOMENT] - twice.shape.params["at"]) > apart:
                yield twice


def changes_at_a_moment(
    before: Fitted,
    shapes: Sequence[Shape],
    confirmed: Sequence[EffectEvidence],
    rules: DecisionRules,
    told: Callable[[str], None],
) -> Iterator[EffectEvidence]:
    """The refits of all that makes a machine warmer or cooler from a moment on, looked for once more where the best of
    these that has no name has led, if that explains much of what the best of all does.

    Before it the model's own parameters and the noise have made up for the change, and no moment stands out; once it is
    known about when, and where the parameters lie, the others are told from it.
    """
    top = max((each.gain for each in confirmed), default=0.0)
    dated = [each for each in confirmed if each.entry.rival and each.entry.name in CHANGES_AT_A_MOMENT]
    best = max(dated, key=lambda each: each.gain, default=None)
    if best is None or best.fitted is None or best.gain < max(rules.least_gain_nats, LOOKED_AGAIN_SHARE * top):
        return
    around = without_last(best.fitted)
    projector = Projector(around)
    for name in CHANGES_AT_A_MOMENT:
        some = tuple(shape for shape in shapes if shape.entry.name == name)
        if some:
            told(name)
            again = screen_shapes(projector, some, shape_columns(projector, some))
            yield confirm(before, _evidence(again, int(np.argmax(again.gain))), around)


def _replace_evidence(confirmed: Sequence[EffectEvidence], again: EffectEvidence) -> list[EffectEvidence]:
    """The evidence with one more refit, in the place of the other one of its entry if that has gained less."""
    old = next((each for each in confirmed if each.entry.name == again.entry.name), again)
    others = [each for each in confirmed if each.entry.name != again.entry.name]
    return [*others, max(again, old, key=lambda each: each.gain)]


def _slim_but_best(confirmed: Sequence[EffectEvidence]) -> list[EffectEvidence]:
    """The evidence with the refits slim, but for that of the greatest gain, which may become a name."""
    top = max(each.gain for each in confirmed)
    return [
        replace(each, fitted=slim(each.fitted)) if each.gain < top and each.fitted is not None else each
        for each in confirmed
    ]


def _neighbour_evidence(
    before: Fitted, confirmed: Sequence[EffectEvidence], entries: Sequence[CatalogueEntry], threshold: float
) -> list[EffectEvidence]:
    """The evidence of a neighbour that nobody measures, where it explains more than anything else, and all of that.

    What is beyond chance beside it, too, is no part of it: a heat that may be anything takes nothing's place.
    """
    entry = next((each for each in entries if each.name == UNMEASURED_NEIGHBOUR), None)
    # Beside a name it would take up what the name's shape, which is never quite the plant's, leaves behind.
    if entry is None or any(named.existing is None for named in before.state.named):
        return []
    others = sorted((each for each in confirmed if each.gain >= threshold), key=lambda each: -each.gain)
    needed = max([threshold, *(each.gain for each in others)])
    # As with the others: what is next to nothing under the noise of the fit before is not worth a fit.
    promised = gain_at_once(before)
    if PROMISED_TIMES * promised < needed:
        return []
    found = slow_heat(before)
    gain = found.fitted.likelihood - before.likelihood - entry.burden
    if gain < needed:
        return []
    for other in others[:NEIGHBOUR_RIVALS]:
        if other.fitted is not None:
            both = with_heats(restore_fit(other.fitted), found.heats).likelihood - other.entry.burden
            if both - found.fitted.likelihood >= threshold:
                return []
    shape = Shape(entry, {}, {"memory": found.spacing})
    named = shape.with_strength(found.sigma)
    z = float(np.sqrt(2.0 * gain))
    return [
        EffectEvidence(
            entry=entry,
            shape=shape,
            gain=gain,
            visible=1.0,
            z=z,
            robust=z,
            cycles=found.cycles,
            spread=float(found.cycles[1]),
            carried=gain,
            amplitude=_visible_size(before, found.course),
            fitted=_with_name(found.fitted, named),
        )
    ]


def _with_name(fitted: Fitted, named: Named) -> Fitted:
    """A fit that has in its noise what `named` stands for, with its name: it moves nothing by its strength."""
    return replace(
        fitted,
        state=replace(fitted.state, named=(*fitted.state.named, named)),
        columns=np.column_stack([fitted.columns, np.zeros(fitted.residual.size)]),
        prior=np.append(fitted.prior, 1.0),
        off=np.append(fitted.off, 0.0),
        covariance=scipy.linalg.block_diag(fitted.covariance, np.eye(1)),
    )


def margin_of_class(gain: float, rules: DecisionRules) -> float:
    """nats that one of the class of a name with that gain must lie behind it."""
    return max(rules.margin_nats, rules.margin_share * gain)


def without_idle(evidence: Sequence[EffectEvidence], rules: DecisionRules) -> list[EffectEvidence]:
    """The evidence without what does no better than a special case of itself, and a rival no better than the names, but
    for one that the best rival cannot be told from.

    A special case stands for what does no better: with it a rival takes the names' place where the wider one does.
    """
    names = max((each.gain for each in evidence if not each.entry.rival), default=-np.inf)

    def ahead(one: EffectEvidence, of: float) -> bool:
        return one.gain - of >= margin_of_class(one.gain, rules)

    def idle(one: EffectEvidence) -> bool:
        special = one.entry.candidate.special
        if not ahead(one, max((each.gain for each in evidence if each.entry.name in special), default=-np.inf)):
            return True
        wider = (each for each in evidence if one.entry.name in each.entry.candidate.special)
        same = (one, *(each for each in wider if not ahead(each, one.gain)))
        return one.entry.rival and not any(ahead(each, names) for each in same)

    left = [each for each in evidence if not idle(each)]
    best = max(left, key=lambda each: each.gain, default=None)
    if best is None or not best.entry.rival:
        return left
    near = best.gain - margin_of_class(best.gain, rules)
    return [each for each in evidence if not idle(each) or (each.gain > near and _are_twins(best, each))]


def _are_twins(best: EffectEvidence, other: EffectEvidence) -> bool:
    """Whether they are twins under one load that never stops, both refitted."""
    return {best.entry.name, other.entry.name} == TWINS_OF_LOSS and other.is_joint


def _evidence(screened: Screen, number: int) -> EffectEvidence:
    """What the screen says of one shape, and whether many cycles say it or a few.

    The score is a sum over cycles, and so is its information. `spread` is the effective number of cycles (Kish 1965:
    the squared sum by the sum of squares), `robust` the score in units of its scatter from cycle to cycle (the
    sandwich's z, which needs no noise model), `carried` the log-likelihood of each cycle under the strength that the
    others give: what one cycle alone made up is lost in it.
    """
    shape = screened.shapes[number]
    parts, shares = screened.by_cycle[:, number], np.maximum(screened.information[:, number], 0.0)
    total, mass = float(parts.sum()), float(shares.sum())
    spread = mass**2 / max(float(np.sum(shares**2)), 1e-300)
    # A cycle with less than a fiftieth of the usual share has no vote: its sign would be chance.
    speaking = shares > 0.02 * mass / max(spread, 1.0)
    same = np.sign(parts[speaking]) == np.sign(total)
    rest = mass - shares
    others = np.where(rest > 1e-9 * mass, total - parts, 0.0) / np.maximum(rest, 1e-9 * max(mass, 1e-280))
    carried = float(np.sum(parts * others - 0.5 * shares * others**2))
    return EffectEvidence(
        entry=shape.entry,
        shape=shape,
        gain=float(screened.gain[number]),
        visible=float(screened.visible[number]),
        z=float(screened.standardised_strengths[number]),
        robust=total / max(float(np.sqrt(np.sum(parts**2))), 1e-300),
        cycles=(int(same.sum()), int(speaking.sum())),
        spread=float(spread),
        carried=carried,
        amplitude=0.0,
        fitted=None,
    )


def confirm(before: Fitted, evidence: EffectEvidence, around: Fitted | None = None) -> EffectEvidence:
    """The evidence with its shape refined and everything fitted anew together: the likeliest of its alternatives.

    The search begins `around` another point than the fit `before`, where there is one; the gain is over that fit.
    """
    around = before if around is None else around
    shapes = _alternatives(before, evidence)
    # The three answers below are all taken in the linear problem around a point: strength, shape, and how far the
    # model's own parameters move to make room. The joint refit starts from there.
    projector = Projector(around)
    usual = projector if around is before else Projector(before)
    rates = before.own - before.frame.count[1]
    trials = []
    for shape in shapes:
        size, score = projector.size_and_score(shape_columns(projector, (shape,))[:, 0])
        named = refine_shape(projector, shape, score / size if size > 0 else 0.0)
        unit = Shape(named.entry, named.signals, _without_strength(named))
        column = shape_columns(projector, (unit,))[:, 0] * (1.0 if named.entry.whole else named.strength)
        moved = projector.made_room(column)[: before.own]
        # The linear problem does not hold for a rate that changes by more than a factor e; Newton's steps go on.
        moved[rates:] = np.clip(moved[rates:], -1.0, 1.0)
        trials += [([*before.state.named, named], start, moved) for start in begins(around)]

    def refit(together: Sequence[Named], start: Fitted, moved: Array | None, rounds: int) -> Fitted:
        hopeless = before.likelihood - HOPELESS_NATS
        return fit(before.frame, together, start, moved=moved, rounds=rounds, iterations=8, hopeless=hopeless)

    if len(trials) == 1:
        fitted = refit(*trials[0], CONFIRM_ROUNDS)
    else:
        # Where there are several, one round tells which of them leads to the highest top.
        first = max((refit(*trial, 1) for trial in trials), key=lambda each: each.likelihood)
        further = refit(first.state.named, first, None, CONFIRM_ROUNDS - 1)
        fitted = max(further, first, key=lambda each: each.likelihood)
    last = fitted.state.named[-1]
    shape = Shape(evidence.entry, last.signals, _without_strength(last))
    gain = fitted.likelihood - before.likelihood - evidence.entry.burden
    return replace(evidence, shape=shape, gain=gain, amplitude=amplitude(usual, shape, last), fitted=fitted)


def _alternatives(before: Fitted, evidence: EffectEvidence) -> list[Shape]:
    """The evidence's shape with every value of the parameters that are fitted either way, but those that come to the
    same effect (walls of the room's temperature where no room is measured)."""
    either = evidence.entry.either
    shapes = list[Shape]()
    seen = list[tuple[Effect, ...]]()
    for values in product(*either.values()):
        shape = replace(evidence.shape, params={**evidence.shape.params, **dict(zip(either, values, strict=True))})
        effects = automaton_effects(shape.with_strength(1.0), before.frame.record.model)
        if effects not in seen:
            seen.append(effects)
            shapes.append(shape)
    return shapes


def begins(before: Fitted) -> tuple[Fitted, ...]:
    """The fits that a joint refit begins from: the one before, and where that is of a rough plant, of a quiet one too.

    Where an error of the reading may last, the likelihood has two tops: a rough plant with a good sensor, and a quiet
    plant with a poor one. From the first no step would see what the effects do together in the second.
    """
    noise, rates = before.noise, before.grid.k[before.grid.k > 0]
    # A process that moves the plant, at its own rate, by no more than a window's mean errs by.
    process = noise.sensor * float(np.sqrt(2.0 * np.median(rates))) if rates.size else 0.0
    if noise.lasting <= 0 or noise.process <= process:
        return (before,)
    lasting = max(float(np.sqrt(np.mean(before.residual**2))), noise.sensor)
    return before, replace(before, noise=replace(noise, process=process, lasting=lasting))


def amplitude(before: Projector, shape: Shape, named: Named) -> float:
    """degC rms over the windows of what an effect does that the parameters of the fit before cannot imitate."""
    column = shape_columns(before, (shape,))[:, 0]
    return abs(1.0 if named.entry.whole else named.strength) * _visible_size(before.fitted, column)


def _visible_size(before: Fitted, column: Array) -> float:
    # What the model's own parameters can imitate would be fitted away and is nobody's effect.
    left = column - before.columns @ np.linalg.lstsq(before.columns, column, rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _without_strength(named: Named) -> dict[str, float]:
    if named.entry.whole:
        return dict(named.params)
    return {name: value for name, value in named.params.items() if name != named.entry.strength}


def _cosines(before: Fitted, evidence: Sequence[EffectEvidence]) -> dict[str, float]:
    """Cosines in the inverse covariance's product, under the noise of the best entry's refit where there is one.

    Without the refit the noise would still hold what the effect does, and everything would look alike in it.
    """
    if not evidence:
        return {}
    top = evidence[0]
    projector = Projector(before if top.fitted is None else replace(before, noise=top.fitted.noise))
    cosine = projector.cosines(shape_columns(projector, [each.shape for each in evidence]))
    return {each.entry.name: float(cosine[number]) for number, each in enumerate(evidence) if number}


def likeness(step: NamingStep, further: EffectEvidence) -> float:
    """The size of the cosine of a step's best effect with the shape that a later step found of another one."""
    if step.best is None:
        return 0.0
    # A name that is looked at again is in the fit before those after it: projected out of itself, nothing is left of it
    # but rounding, which is like anything.
    before = _without_columns(step.before, further.entry.name)
    return abs(_cosines(before, (step.best, further))[further.entry.name])


def _without_columns(fitted: Fitted, name: str) -> Fitted:
    """The linear problem around a fit in which the parameters of the effect `name` do not move."""
    widths = [(named.entry.name, len(named.free)) for named in fitted.state.named]
    free = np.array(
        [*(True for _ in range(fitted.own)), *(each != name for each, width in widths for _ in range(width))]
    )
    return replace(fitted, columns=fitted.columns[:, free], prior=fitted.prior[free], off=fitted.off[free])


def entries_besides(named: Sequence[Named], entries: Sequence[CatalogueEntry] = ()) -> tuple[CatalogueEntry, ...]:
    """Of the entries (the catalogue, without any) those that are neither named already nor ruled out by a name; and the
    rivals of all names. Beside a name of `ONE_CHAIN` no other heat comes late either."""
    taken = {each.entry.name for each in named}
    chained = bool(taken & ONE_CHAIN)
    taken |= ONE_CHAIN if chained else set()
    left = (entry for entry in (*(entries or catalogue()), *rivals()) if entry.name not in taken)
    return tuple(_at_once(entry) if chained and entry.kind.late is not None else entry for entry in left)


def _at_once(entry: CatalogueEntry) -> CatalogueEntry:
    """The entry with those of its shapes in which nothing comes late."""
    late, shapes = entry.kind.late, entry.candidate.shapes
    if late is None:
        return entry
    lag = late.lag
    return replace(
        entry, candidate=replace(entry.candidate, shapes=lambda log: [each for each in shapes(log) if lag not in each])
    )
