"""How long a bus has said nothing while somebody listened: a pause of this process is no silence of the bus."""

from dataclasses import dataclass


@dataclass(slots=True)
class AttendedSilence:
    """The part of a silence for which this process has looked, at the moment `looked` last (s, of any steady clock).

    A look that comes late was not looking meanwhile: the frames of that time may still wait, or the system had no
    more place for them. So the silence of a bus is believed in the end, however late the looks come.
    """

    looked: float
    seconds: float = 0.0

    def look(self, silent: float, now: float, most: float) -> float:
        """The attended part of the `silent` seconds up to `now`; of those since the last look `most` count."""
        self.seconds = min(silent, self.seconds + min(now - self.looked, most))
        self.looked = now
        return self.seconds
