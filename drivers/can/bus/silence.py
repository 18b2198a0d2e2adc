"""How long a bus has said nothing while somebody listened: a pause of this process is no silence of the bus."""

from dataclasses import dataclass

_MIN_CHECKS_PER_SILENCE = 8
"""Looks within the silence that ends a connection, at least: one that comes late is a small part of it."""


def pause_between_looks(limit: float, most: float) -> float:
    """Seconds from one look to the next where a silence of `limit` (s) is the end; `most` (s) at most."""
    return min(most, limit / _MIN_CHECKS_PER_SILENCE)


@dataclass(slots=True)
class AttendedSilence:
    """The part of a silence for which this process has looked, at the moment `looked` last (s, of any steady clock).

    A look that comes late was not looking meanwhile: the frames of that time may still wait, or the system had no
    more place for them. So the silence of a bus is believed in the end, however late the looks come.
    """

    looked: float
    seconds: float = 0.0

    def look(self, silent: float, now: float, pause: float) -> float:
        """The attended part of the `silent` seconds up to `now`; of those since the last look two pauses count."""
        self.seconds = min(silent, self.seconds + min(now - self.looked, 2.0 * pause))
        self.looked = now
        return self.seconds
