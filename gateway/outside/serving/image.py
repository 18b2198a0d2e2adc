"""What one machine's peers see: its register map as it was read last, and how good and how old each tag is.

The tags of a Modbus device lie where they lie in the device; those of any other follow one another in the holding
registers from 0 on. The state of the readings lies in holding and input registers alike, from `address` on:

    address + 0   1, the layout of this area
    address + 1   scans, modulo 65536: it moves while the gateway reads
    address + 2   age of the last scan in tenths of a second; 65535: none yet, or older
    address + 3   how many tags follow
    address + 4   quality of the first tag: the upper half of its OPC UA status code (0 good, bit 15 bad, bit 14
                  uncertain)
    address + 5   age of that reading, as above; and so on, two registers a tag

What lies between two tags is read as 0 and has no quality; a request of nothing else is refused.

A tag whose quality is bad shows what the device itself would show of a value that it has not (its sentinel; NaN), or,
where there is no such thing, its last good value: the quality says so. A request of which no tag is known is answered
by exception 11, as a gateway answers for a device that does not: who reads no quality register reads no stale value
alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from drivers.codec import encode, register_count
from drivers.driver import capabilities, load_function
from drivers.errors import AddressError, DriverError, EncodingError
from drivers.settings import ConfigError
from drivers.tag import DType, Quality, Sample, Tag
from gateway.machine.reading import Scan, unread
from gateway.settings import Config

LAYOUT_VERSION, HEAD_WORDS, WORDS_PER_TAG = 1, 4, 2
NO_AGE = 0xFFFF
"""The age of what is not there, or older than 65534 tenths of a second."""
ILLEGAL_ADDRESS, TARGET_SILENT = 2, 11
_STATE_TABLES = ("holding", "input")
_NOT_A_NUMBER = {DType.FLOAT32: (DType.UINT32, 0x7FC00000), DType.FLOAT64: (DType.UINT64, 0x7FF8 << 48)}


@dataclass(frozen=True, slots=True)
class ServedRow:
    """Where a peer finds a tag: its table, first PDU address and count, and the registers of its quality and age."""

    tag: Tag
    table: str
    start: int
    count: int
    quality: int
    age: int


def served_rows(config: Config) -> tuple[ServedRow, ...]:
    """Where the tags of a machine are served, and their qualities and ages.

    Raises ConfigError where these have no room, or lie over tags.
    """
    device, address = config.map, config.serve.address
    locates = capabilities(device.driver).locates
    place: Callable[[Tag], tuple[str, int, int]] = load_function(locates) if locates else _place_allocator()
    rows: list[ServedRow] = []
    problems: list[str] = []
    end = address + HEAD_WORDS + WORDS_PER_TAG * len(device.tags)
    if end > 0x10000:
        reason = f"{address} leaves no room for {len(device.tags)} tags; give a lower one"
        raise ConfigError([f"{config.path}: serve.address: {reason}"])
    for tag in device.tags:
        if tag.scale_from:
            # A peer would scale it by a factor of its own reading, of another moment or of none.
            reason = f"tags: {tag.name} has its scale from a register, which a peer cannot know"
            problems.append(f"{device.path}: {reason}; leave [serve] out, or give the tag a scale of its own")
            continue
        try:
            table, start, count = place(tag)
        except AddressError as error:
            problems.append(f"{device.path}: {error}; it is not served until that is corrected")
            continue
        if table in _STATE_TABLES and start < end and start + count > address:
            problems.append(
                f"{config.path}: serve.address: {table}:{address} to {end - 1} lies over {tag.name} ({table}:{start}); "
                "give an address that the device does not use"
            )
        first = address + HEAD_WORDS + WORDS_PER_TAG * len(rows)
        rows.append(ServedRow(tag, table, start, count, quality=first, age=first + 1))
    if problems:
        raise ConfigError(problems)
    return tuple(rows)


def _place_allocator() -> Callable[[Tag], tuple[str, int, int]]:
    """Places one after another in the holding registers, for tags that have none of their own."""
    reach = 0

    def place(tag: Tag) -> tuple[str, int, int]:
        nonlocal reach
        start, count = reach, register_count(replace(tag, bit=None))
        reach += count
        return "holding", start, count

    return place


class DeviceImage:
    """One machine's registers for its peers. `take` each scan; `read` answers a request by what is known now.

    `now` gives plant seconds UTC.
    """

    def __init__(self, config: Config, now: Callable[[], float]) -> None:
        """Raises ConfigError (see `served_rows`)."""
        self.rows = served_rows(config)
        self._state, self._now, self._period = config.serve.address, now, config.scan.period
        self._scan: Scan | None = None
        self._good: dict[str, Sample] = {}
        self._at: dict[tuple[str, int], list[ServedRow]] = {}
        for row in self.rows:
            for number in range(row.start, row.start + row.count):
                self._at.setdefault((row.table, number), []).append(row)
        # From each table's first address to its last: a hole between tags reads as 0, as it does in many devices, so
        # that a peer's one block need not be cut.
        self._ends = {
            table: range(min(row.start for row in rows), max(row.start + row.count for row in rows))
            for table in {row.table for row in self.rows}
            if (rows := [row for row in self.rows if row.table == table])
        }

    def take(self, scan: Scan) -> None:
        """This is what was read last."""
        self._scan = scan
        self._good.update({name: sample for name, sample in scan.samples.items() if sample.quality.is_good})

    def read(self, table: str, start: int, count: int) -> list[int] | int:
        """The registers (or bits as 0 and 1) of a request, or the code of the exception that answers it."""
        numbers = range(start, start + count)
        last = self._state + HEAD_WORDS + WORDS_PER_TAG * len(self.rows)
        if table in _STATE_TABLES and self._state <= start and start + count <= last:
            state = self._states()
            return state[start - self._state : start - self._state + count]
        rows = {row.tag.name: row for number in numbers for row in self._at.get((table, number), ())}
        ends = self._ends.get(table, range(0))
        if not rows or start not in ends or start + count - 1 not in ends:
            return ILLEGAL_ADDRESS
        known = {name: self._sample(name) for name in rows}
        if all(sample.quality.is_bad for sample in known.values()):
            return TARGET_SILENT
        words = dict.fromkeys(numbers, 0)
        for name, row in rows.items():
            for number, word in enumerate(self._words(row, known[name]), start=row.start):
                if number in words:
                    # Bits of one register may be tags of their own.
                    words[number] |= word
        return list(words.values())

    def _sample(self, name: str) -> Sample:
        """What the tag is worth now, by the same limits as within a scan."""
        scan = self._scan
        sample = scan.samples.get(name) if scan is not None else None
        if scan is None or sample is None:
            return Sample(name, None, Quality.WAITING_FOR_INITIAL_DATA, self._now())
        return unread(sample, self._now() - scan.time, (1 + scan.missed) * self._period)

    def _states(self) -> list[int]:
        """The whole state area."""
        scan, now = self._scan, self._now()
        number, age = (scan.number % 0x10000, now - scan.time) if scan else (0, None)
        words = [LAYOUT_VERSION, number, _tenths(age), len(self.rows)]
        for row in self.rows:
            sample = self._sample(row.tag.name)
            # A failed reading has the time of its failure: its age is that of the last good value.
            told = self._good.get(row.tag.name) if sample.quality.is_bad else sample
            words += [sample.quality >> 16, _tenths(None if told is None else now - told.time)]
        return words

    def _words(self, row: ServedRow, sample: Sample) -> Sequence[int]:
        tag = row.tag
        if sample.quality.is_bad or sample.value is None:
            absent = _absent(tag)
            good = self._good.get(tag.name)
            if absent is not None or good is None or good.value is None:
                return absent or [0] * row.count
            sample = good
        value = sample.value
        try:
            if tag.bit is not None:
                return [int(bool(value)) << tag.bit]
            # Range and sentinel were judged when it was read: what is served is the number that was.
            plain = replace(tag, low=None, high=None, sentinel=None)
            return encode(plain, "" if value is None else value)
        except (EncodingError, AddressError):
            return _absent(tag) or [0] * row.count


def _absent(tag: Tag) -> list[int] | None:
    """The registers by which the device would say that it has no value; None where it has no way to say so."""
    if tag.bit is not None:
        return None
    raw = replace(tag, scale=1.0, offset=0.0, low=None, high=None, sentinel=None, labels={})
    if tag.sentinel is not None:
        # A manual may print an int16's -32768 as 32768 (0x8000).
        for pattern in (tag.sentinel, tag.sentinel - 0x10000, tag.sentinel - 0x100000000):
            try:
                return encode(raw, pattern)
            except DriverError:
                continue
    if tag.dtype in _NOT_A_NUMBER:
        dtype, bits = _NOT_A_NUMBER[tag.dtype]
        return encode(replace(raw, dtype=dtype), bits)
    return None


def _tenths(seconds: float | None) -> int:
    return NO_AGE if seconds is None else min(NO_AGE, max(0, round(10 * seconds)))
