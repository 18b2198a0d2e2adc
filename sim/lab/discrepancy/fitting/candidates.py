"""The kinds of effects that a diagnosis may name: the rows of the table of effects that say how they are looked for."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from sim.effects import EFFECTS, RIVALS, EffectCandidate, EffectKind, effect_kind, own_kind
from sim.sha import Effect, EffectLine


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """A kind that can be named, with how it is looked for. What is said here is said of `kind` and its candidate.

    `line` is the engineer's own, of which the kind was made; None for one of the catalogue.
    """

    kind: EffectKind
    candidate: EffectCandidate
    line: EffectLine | None = None

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
    def rival(self) -> bool:
        """True where it has no name itself."""
        return self.name in RIVALS

    @property
    def needs(self) -> tuple[str, ...]:
        """The roles of the signals without which it cannot be told."""
        return self.kind.required_roles

    def role_key(self, role: str) -> str:
        """What a role is called among all roles: a line's own roles are its own, whatever they are called."""
        return role if self.line is None else f"{self.name}.{role}"


def catalogue(own: Sequence[EffectLine] = ()) -> tuple[CatalogueEntry, ...]:
    """Every kind that can be named, in the table's order, and then those of the lines. Raises LineError."""
    return (*_entries(EFFECTS.values()), *(entry_of_line(line) for line in own))


def rivals() -> tuple[CatalogueEntry, ...]:
    """What no name may be given in place of, and which has none itself."""
    return _entries(RIVALS.values())


def _entries(kinds: Iterable[EffectKind]) -> tuple[CatalogueEntry, ...]:
    return tuple(CatalogueEntry(kind, kind.candidate) for kind in kinds if kind.candidate is not None)


def entry_of_line(line: EffectLine) -> CatalogueEntry:
    """The entry of an engineer's line. Raises LineError, a ValueError, with the key and the reason."""
    kind = own_kind(line)
    if kind.candidate is None:
        raise ValueError(f"the effect {line.name!r} does not say how it is looked for")
    return CatalogueEntry(kind, kind.candidate, line)


def own_roles(own: Sequence[EffectLine]) -> dict[str, str]:
    """The signals of the lines' roles, by `role_key`."""
    return {entry_of_line(line).role_key(role): signal for line in own for role, signal in line.signals}


def entry_of_effect(effect: Effect) -> CatalogueEntry:
    """The entry of an effect that a model has. Raises ValueError for one that a diagnosis does not know."""
    effect_kind(effect)
    return catalogue_entry(effect.kind) if effect.line is None else entry_of_line(effect.line)


def catalogue_entry(name: str) -> CatalogueEntry:
    """The entry of a kind. Raises ValueError, naming it, for one that a diagnosis does not know."""
    entry = next((known for known in catalogue() if known.name == name), None)
    if entry is None:
        raise ValueError(f"a diagnosis does not know effects of the kind {name!r}: there is no strength to be fitted")
    return entry


def role_signals(entry: CatalogueEntry, present: Mapping[str, str]) -> dict[str, str] | None:
    """role -> signal for an entry from the roles that are `present`; None where a needed one is missing."""
    keys = {role: entry.role_key(role) for role in (*entry.needs, *entry.kind.optional)}
    if any(keys[role] not in present for role in entry.needs):
        return None
    return {role: present[key] for role, key in keys.items() if key in present}
