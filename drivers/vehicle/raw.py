"""Plain fields and DBC signals out of recorded frames: what the live driver does, on the frames' own clock (pure)."""

from collections.abc import Mapping, Sequence

from drivers.can.fields import frame_key, value_of
from drivers.can.frame import Found, Frame
from drivers.can.reception import Reception, Slot
from drivers.can.signals import Place, SignalMap
from drivers.tag import Tag


class RawListener:
    """Readings of tags with `0x181:16|16` and `dbc:` addresses. Raises AddressError for a tag that it cannot mean."""

    def __init__(self, tags: Sequence[Tag], signals: SignalMap) -> None:
        self._reception = Reception()
        self._places: dict[int, list[tuple[Tag, Place]]] = {}
        self.timeouts: dict[str, float] = {}
        for tag in tags:
            place = signals.place(tag)
            _, slot = self._reception.listen(place.rules, place.field.conditions, place.timeout, 0.0)
            self._places.setdefault(id(slot), []).append((tag, place))
            self.timeouts[tag.name] = place.timeout

    def take(self, frame: Frame) -> Sequence[Found]:
        """What the frame says of the tags; one of a wrong length, checksum or sequence says nothing."""
        slots: Sequence[Slot] = self._reception.take(frame_key(frame.id, extended=frame.extended), frame, frame.time)
        return [
            Found(tag, value_of(place.tag, place.field, frame.data))
            for slot in slots
            for tag, place in self._places.get(id(slot), ())
        ]

    def counts(self) -> Mapping[str, int]:
        """Frames that were used, refused (length, checksum, sequence), and of messages without a tag."""
        return {f"raw_{name}": count for name, count in self._reception.counts.items()}
