"""Things of a few kinds with constants, made ready for arrays: what is done by kind is done once for all of a kind."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.sha.trace import Array, Mask

Indices = NDArray[np.intp]


class Kinded(Protocol):
    """A flow, a law: a kind and its constants by name."""

    @property
    def kind(self) -> str:
        """Its kind."""
        ...

    @property
    def params(self) -> Mapping[str, float]:
        """Its constants."""
        ...


@dataclass(frozen=True, slots=True)
class OfKind:
    """Those of L things that are of one `kind`: which they are, and each constant by number (L,), NaN elsewhere."""

    kind: str
    members: Mask
    constants: Mapping[str, Array]

    def at(self, place: Indices) -> Mapping[str, Array]:
        """The constants of the things with the numbers `place`, of its shape."""
        return {name: column[place] for name, column in self.constants.items()}


def by_kind(things: Sequence[Kinded | None]) -> tuple[OfKind, ...]:
    """The things by kind, in the order in which these come first; None is of no kind."""
    found = []
    for kind in dict.fromkeys(thing.kind for thing in things if thing is not None):
        own = [thing.params if thing is not None and thing.kind == kind else None for thing in things]
        names = dict.fromkeys(name for params in own if params is not None for name in params)
        constants = {name: np.array([nan if p is None else p.get(name, nan) for p in own]) for name in names}
        found.append(OfKind(kind, np.array([p is not None for p in own]), constants))
    return tuple(found)
