"""The kinds of effects that a diagnosis may name: the rows of the table of effects that say how they are looked for."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim.effects import EFFECTS, EffectCandidate, EffectKind


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """A kind that can be named, with how it is looked for. What is said here is said of `kind` and its candidate."""

    kind: EffectKind
    candidate: EffectCandidate

    @property
    def name(self) -> str:
        """The kind's name."""
        return self.kind.name

    @property
    def plain(self) -> str:
        """What the effect is."""
        return self.kind.meaning

    @property
    def experiment(self) -> str:
        """What would tell it from its twins."""
        return self.candidate.experiment

    @property
    def strength(self) -> str:
        """The parameter that scales it."""
        return self.candidate.strength

    @property
    def sign(self) -> float:
        """What physics allows of the strength; 0: either."""
        return self.candidate.sign

    @property
    def whole(self) -> bool:
        """True where the strength is itself a time (of a lag, of a delay): the effect is there once, not times c."""
        return self.candidate.once

    @property
    def burden(self) -> float:
        """Nats that looking at many places costs."""
        return self.candidate.burden

    @property
    def either(self) -> Mapping[str, Sequence[float]]:
        """Shape parameters of which every value is fitted."""
        return self.candidate.either

    @property
    def needs(self) -> tuple[str, ...]:
        """The roles of the signals without which it cannot be told."""
        return self.kind.needed


def catalogue() -> tuple[CatalogueEntry, ...]:
    """Every kind that can be named, in the table's order."""
    return tuple(CatalogueEntry(kind, kind.candidate) for kind in EFFECTS.values() if kind.candidate is not None)


def entry_of(name: str) -> CatalogueEntry:
    """The entry of a kind. Raises ValueError, naming it, for one that a diagnosis does not know."""
    entry = next((known for known in catalogue() if known.name == name), None)
    if entry is None:
        raise ValueError(f"a diagnosis does not know effects of the kind {name!r}: there is no strength to be fitted")
    return entry


def signals_of(entry: CatalogueEntry, present: Mapping[str, str]) -> dict[str, str] | None:
    """role -> signal for an entry from the roles that are `present`; None where a needed one is missing."""
    if any(role not in present for role in entry.needs):
        return None
    return {role: present[role] for role in (*entry.needs, *entry.kind.optional) if role in present}
