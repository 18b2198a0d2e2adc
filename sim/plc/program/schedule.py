"""The faults in force: each begins, strikes requests, and ends; its draws depend on the seed and its number alone."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from random import Random

from sim.plc.program.checks import InputError
from sim.plc.program.faults import FaultEffect, OrderedFault, merge_effects


@dataclass(slots=True)
class Scheduled:
    """A fault and how far it has come; `begins` is monotonic seconds."""

    number: int
    fault: OrderedFault
    begins: float
    rng: Random
    hits: int = 0
    began: bool = False
    ended: bool = False

    def in_force(self, now: float) -> bool:
        """True between its beginning and its end."""
        if self.ended or now < self.begins or self.is_spent:
            return False
        return self.fault.duration is None or now < self.begins + self.fault.duration

    @property
    def is_spent(self) -> bool:
        """True when it has struck as many requests as it was to."""
        return self.fault.count is not None and self.hits >= self.fault.count

    def effect(self, now: float) -> FaultEffect:
        """What it does at the moment."""
        return self.fault.effect(now - self.begins)


@dataclass(frozen=True, slots=True)
class CycleFaults:
    """What a cycle asks of the faces: the faults in force, and those that have just begun.

    Each effect stands beside the face that it strikes, "" for all of them; `face_faults` narrows the line to one face.
    """

    standing: tuple[tuple[str, FaultEffect], ...] = ()
    begun: tuple[tuple[str, FaultEffect], ...] = ()

    def face_faults(self, face: str) -> "CycleFaults":
        """The line as one face has to obey it."""
        standing = tuple(pair for pair in self.standing if pair[0] in ("", face))
        return CycleFaults(standing, tuple(pair for pair in self.begun if pair[0] in ("", face)))

    @property
    def listen(self) -> bool:
        """False while the face must not be reachable."""
        return all(effect.listen for _, effect in self.standing)

    @property
    def reset(self) -> bool:
        """True in the cycle in which all connections are to be reset."""
        return any(effect.reset for _, effect in self.begun)

    @property
    def deafen(self) -> bool:
        """True in the cycle in which the open connections are left open and no longer served."""
        return any(effect.deafen for _, effect in self.begun)


@dataclass(slots=True)
class FaultSchedule:
    """All faults that were ordered, by number from 1 on."""

    seed: int = 0
    entries: list[Scheduled] = field(default_factory=list)
    _last: int = 0

    def add(self, fault: OrderedFault, origin: float) -> int:
        """Order a fault whose `start` counts from `origin`; gives its number."""
        self._last += 1
        rng = Random(f"{self.seed}:{self._last}")  # noqa: S311 - a repeatable bench, not a secret
        self.entries.append(Scheduled(self._last, fault, origin + fault.start, rng))
        return self._last

    def clear(self, number: int | None = None) -> list[int]:
        """End one fault, or all; gives the numbers ended. Raises InputError for a number that is not there."""
        chosen = [entry for entry in self.entries if number in (None, entry.number)]
        if number is not None and not chosen:
            raise InputError(f"there is no fault {number} any more; 'status' lists those that are left")
        for entry in chosen:
            entry.ended = True
        return [entry.number for entry in chosen]

    def advance(self, now: float) -> tuple[list[Scheduled], list[Scheduled]]:
        """The faults that have begun and that have ended since the last call; ended ones are forgotten."""
        begun = [entry for entry in self.entries if not entry.began and now >= entry.begins and not entry.ended]
        for entry in begun:
            entry.began = True
        # Among all of them: one that has just begun may be over at once.
        over = [entry for entry in self.entries if self._is_past(entry, now)]
        self.entries = [entry for entry in self.entries if entry not in over]
        return begun, [entry for entry in over if entry.began]

    def standing_effect(self, now: float) -> FaultEffect:
        """The merged effect of all faults in force on the PLC as a whole."""
        return merge_effects(entry.effect(now) for entry in self.entries if entry.in_force(now))

    def line(self, begun: Iterable[Scheduled], now: float) -> CycleFaults:
        """What the faces have to do in the cycle in which the faults `begun` have begun."""
        standing = tuple((entry.fault.face, entry.effect(now)) for entry in self.entries if entry.in_force(now))
        return CycleFaults(standing, tuple((entry.fault.face, entry.effect(now)) for entry in begun))

    def strike(self, function: int, now: float, face: str = "") -> Iterator[tuple[Scheduled, FaultEffect]]:
        """The faults that hit a request of this function code at a face, each with its effect; they are counted."""
        for entry in self.entries:
            wanted = not entry.fault.functions or function in entry.fault.functions
            if not wanted or entry.fault.face not in ("", face) or not entry.in_force(now):
                continue
            effect = entry.effect(now)
            if effect.per_request and entry.rng.random() < entry.fault.probability:
                entry.hits += 1
                yield entry, effect

    @staticmethod
    def _is_past(entry: Scheduled, now: float) -> bool:
        if entry.ended or entry.is_spent:
            return True
        if now < entry.begins:
            return False
        return not entry.in_force(now) or entry.effect(now).over
