"""A whole log decoded at once, as fast as it can be read: for comparing, tracing and learning."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers.can import CanSettings
from drivers.errors import AddressError
from drivers.settings import check_settings
from drivers.tag import Sample, Tag
from drivers.vehicle.decoding import Decoder
from drivers.vehicle.j1939 import identifier
from drivers.vehicle.log import Log, open_log, require_frames
from drivers.vehicle.replay import CanLogSettings

_FRAMES_PER_REPORT = 5_000
_MOST_IDENTIFIERS = 10_000

Progress = Callable[[str, float], None]


@dataclass(slots=True)
class Decoded:
    """A log on its way through the decoder: iterate `samples` once; the rest is complete after that.

    `identifiers` counts the frames by (bus, identifier in words); `readings` the samples by (tag, quality).
    """

    log: Log
    decoder: Decoder
    bus: str | None
    identifiers: Counter[tuple[str, str]] = field(default_factory=Counter)
    readings: Counter[tuple[str, str]] = field(default_factory=Counter)

    def samples(self, progress: Progress) -> Iterator[Sample]:
        """Every reading in the order of the log, each at the logged time of the frame that completed it.

        Raises DriverError at the end if there was no data frame.
        """
        known: dict[tuple[str, int, bool], tuple[str, str]] = {}
        for number, frame in enumerate(self.log.frames()):
            if number % _FRAMES_PER_REPORT == 0:
                progress(f"{number} frames", self.log.progress)
            key = (frame.channel, frame.id, frame.extended)
            # A log of noise has no end of identifiers: beyond so many they are counted together.
            if key not in known and len(known) < _MOST_IDENTIFIERS:
                known[key] = (frame.channel, _name(frame.id, frame.extended))
            self.identifiers[known.get(key, ("", "others"))] += 1
            if self.bus not in (None, frame.channel):
                continue
            for tag, (value, quality, reason) in self.decoder.take(frame):
                self.readings[tag.name, quality.name] += 1
                yield Sample(tag.name, value, quality, frame.time, reason=reason)
        require_frames(self.log)

    def counts(self) -> Mapping[str, int]:
        """What became of the log's records, frames and messages."""
        return {f"log_{name}": count for name, count in self.log.counts.items()} | self.decoder.counts()

    @property
    def problem(self) -> str:
        """What of the log was no data frame, and what of the DBC file no message, in words; "" if nothing."""
        return "; ".join(filter(None, (self.log.summary(), *self.decoder.omissions)))


def decode_log(path: Path, settings: Mapping[str, Any], tags: Sequence[Tag]) -> Decoded:
    """The log at `path` through the tags; `settings` as for the drivers `can-log` and `can`.

    What says how to play or to open a bus is not used. Raises DriverError for a setting, an address or a log that
    cannot be used.
    """
    live = CanSettings.model_fields.keys() - CanLogSettings.model_fields.keys()
    own = {key: value for key, value in settings.items() if key not in live}
    checked = check_settings("can-log", CanLogSettings, {**own, "log": str(path)})
    decoder = Decoder(checked)
    decoder.listen(tags)
    for problem in decoder.problems.values():
        raise AddressError(problem)
    return Decoded(open_log(path, checked.format), decoder, checked.bus)


def _name(number: int, extended: bool) -> str:
    """An identifier in words: hexadecimal, and for 29 bits what J1939 makes of it."""
    if not extended:
        return f"{number:03X}"
    _, pgn, source, destination = identifier(number)
    towards = "" if destination == 0xFF else f" to {destination:02X}"
    return f"{number:08X} (PGN {pgn:04X} from {source:02X}{towards})"
