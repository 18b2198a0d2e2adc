"""The benchmark's strata: which case a (set, stratum, number) is, and the seed of all that is random in it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal
from zlib import crc32

import numpy as np

from benchmarks.discrepancy.effects import EFFECTS, NEEDS
from benchmarks.discrepancy.outside import OUTSIDE

SETS: Mapping[str, int] = {"development": 41_001, "calibration": 52_003, "blind": 63_007}
"""The entropy of each set's seeds. Thresholds are chosen on the first, checked on the second; the third is run once."""

RATIOS = (1.0, 1.5, 2.0, 3.0, 6.0)
"""Signal-to-noise ratios of the singles."""
TWINS = (
    frozenset({"dead-time", "sensor-lag"}),
    frozenset({"quadratic-current-heating", "current-saturation"}),
    frozenset({"ambient-coupling", "housing-thermal-mass"}),
    frozenset({"wear-drift", "sensor-offset-step"}),
    frozenset({"thermostatic-cooling", "radiation-loss"}),
)
"""Known near-twins: no pair is made of them, since no data at hand could tell both apart."""

Sampling = Literal["regular", "irregular", "gaps"]
Learned = Literal["before", "same"]
Base = Literal["stages", "linear"]
CURRENT = "Assorbimento"
NAMES, KINDS = tuple(EFFECTS), tuple(OUTSIDE)


@dataclass(frozen=True, slots=True)
class Spec:
    """One case before anything is drawn: which effects at which signal-to-noise ratio, on what kind of data.

    `learned`: the given model comes from days `before` the effect, or from the `same` traces that are diagnosed.
    `moved`: the plant's constants have changed by up to 8 % since. `missing`: signals that were not recorded. `base`:
    the drive's heat is one a stage, or follows the current in a straight line.
    """

    set: str
    stratum: str
    number: int
    effects: tuple[str, ...] = ()
    ratio: float = 0.0
    rough: bool = True
    moved: bool = False
    learned: Learned = "before"
    days: int = 4
    cycles: int = 4
    sampling: Sampling = "regular"
    missing: tuple[str, ...] = ()
    base: Base = "stages"

    def generator(self, purpose: str) -> np.random.Generator:
        """A generator of its own for each purpose, so that one draw more in one place changes nothing elsewhere."""
        return generator(self.set, f"{self.stratum}/{purpose}", self.number)


def generator(set_: str, label: str, number: int) -> np.random.Generator:
    """PCG64 seeded by SeedSequence([entropy of the set, CRC-32 of the label, number])."""
    return np.random.default_rng(np.random.SeedSequence([SETS[set_], crc32(label.encode()), number]))


def _clean(set_: str, stratum: str, n: int) -> Spec:
    """By turns: as learned; learned before and moved since; learned on the very traces. Every fifth is linear."""
    learned: Learned = "same" if n % 3 == 2 else "before"
    linear: Base = "linear" if n % 5 == 4 else "stages"
    return Spec(set_, stratum, n, rough=stratum == "clean-rough", moved=n % 3 == 1, learned=learned, base=linear)


def _single(set_: str, stratum: str, n: int) -> Spec:
    """Each 170 in a row hold every effect at every ratio on a rough and on a smooth plant; fewer are a fair mixture."""
    effect, turn = n % len(NAMES), n // len(NAMES)
    rough = (effect + turn // 5) % 2 == 0
    return _aged(Spec(set_, stratum, n, (NAMES[effect],), RATIOS[(effect + 3 * turn) % 5], rough))


def _pair(set_: str, stratum: str, n: int) -> Spec:
    """Two effects that are no twins, each at a ratio of 3 or 6 by itself."""
    rng = generator(set_, f"{stratum}/choice", n)
    while True:
        pair = tuple(sorted(rng.choice(NAMES, 2, replace=False).tolist()))
        linear = any(EFFECTS[name].base == "linear" for name in pair)
        if frozenset(pair) not in TWINS and not (linear and "current-heating" in pair):
            break
    return _aged(Spec(set_, stratum, n, pair, (3.0, 6.0)[n % 2], rough=n // 2 % 2 == 0))


def _outside(set_: str, stratum: str, n: int) -> Spec:
    kind, turn = n % len(KINDS), n // len(KINDS)
    return _aged(Spec(set_, stratum, n, (KINDS[kind],), (3.0, 6.0, 1.5)[turn % 3], rough=(kind + turn // 3) % 2 == 0))


def _short(set_: str, stratum: str, n: int) -> Spec:
    """One day: every third case is clean, the others have one effect at a ratio of 3 or 6."""
    if n % 3 == 0:
        return Spec(set_, stratum, n, rough=n // 3 % 2 == 0, days=1)
    return replace(_single(set_, stratum, n), ratio=(3.0, 6.0)[n // 3 % 2], days=1)


def _one_cycle(set_: str, stratum: str, n: int) -> Spec:
    return replace(_short(set_, stratum, n), cycles=1, learned="before")


def _missing(set_: str, stratum: str, n: int) -> Spec:
    """By turns the signal is missing that the effect acts through, or two that have nothing to do with it."""
    name = tuple(NEEDS)[n % len(NEEDS)]
    needed = NEEDS[name]
    spec = _aged(Spec(set_, stratum, n, (name,), (3.0, 6.0)[n // 2 % 2], rough=n % 4 < 2))
    if n % 2 == 0 and needed != CURRENT:
        return replace(spec, missing=(needed, "VelocitaPompa") if needed == "MarciaPmpFango" else (needed,))
    others = sorted(set(NEEDS.values()) - {needed, CURRENT})
    rng = spec.generator("missing")
    return replace(spec, missing=tuple(rng.choice(others, 2, replace=False).tolist()))


def _sampled(set_: str, stratum: str, n: int) -> Spec:
    """Every third case is clean, the others have one effect at a ratio of 2, 3 or 6."""
    sampling: Sampling = "irregular" if stratum == "irregular" else "gaps"
    if n % 3 == 0:
        return Spec(set_, stratum, n, rough=n // 3 % 2 == 0, sampling=sampling)
    return replace(_single(set_, stratum, n), ratio=(2.0, 3.0, 6.0)[n // 3 % 3], sampling=sampling)


def _aged(spec: Spec) -> Spec:
    """The same case with its kind of bearing, and with the given model and its age drawn.

    A model learned on the very traces would follow the current by itself, and nothing would be hidden.
    """
    linear = any(name in EFFECTS and EFFECTS[name].base == "linear" for name in spec.effects)
    rng = spec.generator("model")
    same = bool(rng.random() < 0.3) and "current-heating" not in spec.effects
    moved = bool(rng.random() < 0.5) and not same
    return replace(spec, base="linear" if linear else "stages", learned="same" if same else "before", moved=moved)


@dataclass(frozen=True, slots=True)
class Stratum:
    """`make` gives the spec of a number; `size` is how many cases the full benchmark has of it."""

    make: Callable[[str, str, int], Spec]
    size: int


STRATA: Mapping[str, Stratum] = {
    "clean-smooth": Stratum(_clean, 150),
    "clean-rough": Stratum(_clean, 150),
    "singles": Stratum(_single, 510),
    "pairs": Stratum(_pair, 60),
    "outside": Stratum(_outside, 96),
    "one-day": Stratum(_short, 51),
    "one-cycle": Stratum(_one_cycle, 12),
    "missing": Stratum(_missing, 36),
    "irregular": Stratum(_sampled, 36),
    "gaps": Stratum(_sampled, 36),
}
GROUPS: Mapping[str, tuple[str, ...]] = {"clean": ("clean-smooth", "clean-rough"), "all": tuple(STRATA)}
"""Names that stand for several strata."""


def chosen(names: str) -> tuple[str, ...]:
    """The strata of a comma-separated list. Raises ValueError for a name that is none."""
    found: list[str] = []
    for name in names.split(","):
        group = GROUPS.get(name.strip(), (name.strip(),))
        if not set(group) <= set(STRATA):
            raise ValueError(f"there is no stratum {name.strip()!r}; there are {', '.join([*GROUPS, *STRATA])}")
        found += [one for one in group if one not in found]
    return tuple(found)


def specs(set_: str, strata: Sequence[str], count: int | None = None, first: int = 0) -> list[Spec]:
    """`count` cases of each stratum (as many as the full benchmark has) from number `first` on."""
    return [
        STRATA[stratum].make(set_, stratum, number)
        for stratum in strata
        for number in range(first, first + (STRATA[stratum].size if count is None else count))
    ]
