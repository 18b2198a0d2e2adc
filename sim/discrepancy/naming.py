"""One step towards a name: the catalogue screened, the likeliest confirmed by joint refits and weighed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sim.discrepancy.fitting import CatalogueEntry, Fitted, Named, catalogue, fit
from sim.discrepancy.screen import (
    Projector,
    Screen,
    Shape,
    columns_of,
    judged,
    null_maximum,
    refined,
    screen,
    smooth_course,
)
from sim.sha import Array

CONFIRMED, WORTH = 4, 1.0
"""Entries that are confirmed at most, and the screen's gain (nats) from which it is worth while."""
SURE, LEAST_GAIN = 0.99, 14.0
"""The share of draws without an effect whose greatest gain must lie below a name's, and the gain it needs at least."""
SAME, NEAR = 0.9, 0.6
"""Cosines from which two effects are of one class, or rivals."""
ONE_CHAIN = frozenset({"dead-time", "sensor-lag"})
"""What lies between the heat and the reading is named once: a second name would mend the first one's shape."""
MARGIN, ALIKE = 6.0, 0.01
"""Nats by which a name must beat every rival, and the share of its gain for one of its class: by so little a shape
that is not quite the plant's may win over its twin."""
INVISIBLE = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class EffectEvidence:
    """An entry against what a fit leaves: its best shape, its gain (nats), and the joint refit where there was one.

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
    def confirmed(self) -> bool:
        """True when the gain is that of the joint refit."""
        return self.fitted is not None


@dataclass(frozen=True, slots=True)
class NamingStep:
    """A step from a fit: the evidence of every entry with its signals, best first; the threshold; and cosines.

    `cosines` gives, for the best entry, the cosine of each other entry's effect with its own, the model's parameters
    projected out of both.
    """

    before: Fitted
    evidence: tuple[EffectEvidence, ...]
    threshold: float
    cosines: Mapping[str, float]

    @property
    def best(self) -> EffectEvidence | None:
        """The entry of the greatest gain."""
        return self.evidence[0] if self.evidence else None

    @property
    def members(self) -> tuple[str, ...]:
        """The best entry's name and those of its class that do not lie a whole margin, and ALIKE, behind it."""
        if self.best is None:
            return ()
        top = self.best.gain
        close = [one for one in self.evidence[1:] if abs(self.cosines.get(one.entry.name, 0.0)) >= SAME]
        return (self.best.entry.name, *(one.entry.name for one in close if top - one.gain < max(MARGIN, ALIKE * top)))

    @property
    def margin(self) -> float:
        """Nats by which the best beats every entry outside its members."""
        if self.best is None:
            return 0.0
        others = [one.gain for one in self.evidence[1:] if one.entry.name not in self.members]
        return self.best.gain - max(others, default=0.0)


def step(before: Fitted, entries: Sequence[CatalogueEntry], roles: Mapping[str, str], seed: int) -> NamingStep:
    """Screen and confirm `entries` on top of a fit."""
    found = screen(before, entries, roles)
    # The catalogue is searched, so the greatest gain of many is judged: by its own law under "nothing is missing",
    # drawn from the fitted noise, not by the chi-square of a single test.
    threshold = max(float(np.quantile(null_maximum(found, seed), SURE)), LEAST_GAIN)
    best = found.best()
    evidence = [_evidence(found, number) for number in best.values()]
    chosen = [one for one in evidence[:CONFIRMED] if one.gain >= WORTH]
    confirmed = [confirm(before, one) for one in chosen]
    rest = [one for one in evidence if one.entry.name not in {each.entry.name for each in confirmed}]
    order = tuple(sorted([*confirmed, *rest], key=lambda one: -one.gain))
    return NamingStep(before, order, threshold, _cosines(before, order))


def _evidence(found: Screen, number: int) -> EffectEvidence:
    """What the screen says of one shape, and whether many cycles say it or a few.

    The score is a sum over cycles, and so is its information. `spread` is the effective number of cycles (Kish 1965:
    the squared sum by the sum of squares), `robust` the score in units of its scatter from cycle to cycle (the
    sandwich's z, which needs no noise model), `carried` the log-likelihood of each cycle under the strength that the
    others give: what one cycle alone made up is lost in it.
    """
    shape = found.shapes[number]
    parts, shares = found.by_cycle[:, number], np.maximum(found.information[:, number], 0.0)
    total, mass = float(parts.sum()), float(shares.sum())
    spread = mass**2 / max(float(np.sum(shares**2)), 1e-300)
    # A cycle with less than a fiftieth of the usual share has no vote: its sign would be chance.
    speaking = shares > 0.02 * mass / max(spread, 1.0)
    same = np.sign(parts[speaking]) == np.sign(total)
    others = (total - parts) / np.maximum(mass - shares, 1e-300)
    carried = float(np.sum(parts * others - 0.5 * shares * others**2))
    return EffectEvidence(
        entry=shape.entry,
        shape=shape,
        gain=float(found.gain[number]),
        visible=float(found.visible[number]),
        z=float(found.signed[number]),
        robust=total / max(float(np.sqrt(np.sum(parts**2))), 1e-300),
        cycles=(int(same.sum()), int(speaking.sum())),
        spread=float(spread),
        carried=carried,
        amplitude=0.0,
        fitted=None,
    )


def confirm(before: Fitted, one: EffectEvidence) -> EffectEvidence:
    """The evidence with its shape refined and everything fitted anew together: the likeliest of its alternatives."""
    either = one.entry.either
    shapes = [
        replace(one.shape, params={**one.shape.params, **dict(zip(either, values, strict=True))})
        for values in product(*either.values())
    ]
    return max((_confirmed(before, replace(one, shape=shape)) for shape in shapes), key=lambda each: each.gain)


def _confirmed(before: Fitted, one: EffectEvidence) -> EffectEvidence:
    strength = _first_strength(before, one)
    named = refined(before, one.shape, strength)
    fitted = fit(
        before.frame,
        [*before.state.named, named],
        before,
        moved=_room(before, named),
        rounds=3,
        iterations=8,
    )
    shape = Shape(one.entry, one.shape.signals, _without_strength(fitted.state.named[-1]))
    gain, last = fitted.likelihood - before.likelihood - one.entry.burden, fitted.state.named[-1]
    return replace(one, shape=shape, gain=gain, amplitude=amplitude(before, shape, last), fitted=fitted)


def _room(before: Fitted, named: Named) -> Array:
    """(p + r,) how the model's own parameters move to make room for an effect, log rates by 1 at most."""
    shape = Shape(named.entry, named.signals, _without_strength(named))
    column = columns_of(before, (shape,), smooth_course(before))[:, 0] * (1.0 if named.entry.whole else named.strength)
    moved = Projector(before).made_room(column)[: before.own]
    rates = before.frame.count[1]
    # The linear problem does not hold for a rate that changes by more than a factor e; Newton's steps go on from there.
    moved[before.own - rates :] = np.clip(moved[before.own - rates :], -1.0, 1.0)
    return moved


def amplitude(before: Fitted, shape: Shape, named: Named) -> float:
    """degC rms over the windows of what an effect does that the parameters of the fit before cannot imitate."""
    column = columns_of(before, (shape,), smooth_course(before))[:, 0]
    # What the model's own parameters can imitate would be fitted away and is nobody's effect.
    left = column - before.columns @ np.linalg.lstsq(before.columns, column, rcond=None)[0]
    strength = 1.0 if named.entry.whole else named.strength
    return float(abs(strength) * np.sqrt(np.mean(left**2)))


def _first_strength(before: Fitted, one: EffectEvidence) -> float:
    smooth = smooth_course(before)
    found = judged(before, (one.shape,), columns_of(before, (one.shape,), smooth))
    return float(found.strength[0])


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
    around = before if top.fitted is None else replace(before, noise=top.fitted.noise)
    smooth = smooth_course(around)
    shapes = tuple(one.shape for one in evidence)
    found = judged(around, shapes, columns_of(around, shapes, smooth))
    size = np.sqrt(np.maximum(np.diag(found.normal), 1e-300))
    cosine: Array = found.normal[0] / (size * size[0])
    return {one.entry.name: float(cosine[number]) for number, one in enumerate(evidence) if number}


def entries_besides(named: Sequence[Named], besides: Sequence[str] = ()) -> tuple[CatalogueEntry, ...]:
    """The catalogue without the effects that are named already, what they rule out, and others by name."""
    taken = {one.entry.name for one in named} | set(besides)
    taken |= ONE_CHAIN if taken & ONE_CHAIN else set()
    return tuple(entry for entry in catalogue() if entry.name not in taken)
