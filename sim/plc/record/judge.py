"""The judge: every value that a client called good must be one that the PLC truly had at that time."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from drivers.tag import Sample, Value
from sim.plc.record.recording import PlcRecording, TruthRow

_MAX_LISTED = 5


@dataclass(frozen=True, slots=True)
class WrongGood:
    """A good sample that no true value supports; `truths` are the values that the tag had in its time."""

    sample: Sample
    truths: tuple[Value | None, ...]
    reason: str


@dataclass(frozen=True, slots=True)
class _History:
    times: Sequence[float]
    values: Sequence[Value | None]

    def interval_values(self, start: float, end: float) -> tuple[Value | None, ...]:
        """The values in force at any moment of [start, end]; empty before the first is known."""
        first = max(0, bisect_right(self.times, start) - 1)
        return tuple(self.values[first : bisect_right(self.times, end)])


def wrong_good(recording: PlcRecording, samples: Iterable[Sample], tolerance_s: float = 0.0) -> list[WrongGood]:
    """The samples of good quality whose value the tag did not have at any moment of [sent - tolerance_s, time].

    Times are plant seconds. `tolerance_s` is the age that a value may have and still be called good: 0 for a plain
    read, the detection time of a standing heartbeat for a PLC whose image froze. A value may differ from the truth by
    the rounding of its register, no more. A good sample of a tag that the PLC does not have is wrong.
    """
    by_tag: dict[str, list[TruthRow]] = {}
    for row in sorted(recording.truth, key=lambda row: row.time):
        by_tag.setdefault(row.tag, []).append(row)
    histories = {tag: _History([row.time for row in rows], [row.value for row in rows]) for tag, rows in by_tag.items()}
    roundings = {name: rounding for run in recording.runs for name, rounding in run.roundings.items()}
    wrong = []
    for sample in samples:
        if not sample.quality.is_good:
            continue
        history = histories.get(sample.tag)
        if history is None:
            wrong.append(WrongGood(sample, (), f"the PLC has no tag {sample.tag!r}"))
            continue
        # The device looked at its memory at some moment between request and reply: any value of that time is right.
        start = (sample.time if sample.sent is None else sample.sent) - tolerance_s
        truths = history.interval_values(start, sample.time)
        rounding = roundings.get(sample.tag, (0.0, 0.0))
        if not any(_same(sample.value, truth, rounding) for truth in truths):
            shown = ", ".join(map(repr, truths[-_MAX_LISTED:])) or "nothing yet"
            wrong.append(WrongGood(sample, truths, f"{sample.tag} was said to be {sample.value!r} and was {shown}"))
    return wrong


def _same(value: Value | None, truth: Value | None, rounding: tuple[float, float]) -> bool:
    if value is None or truth is None:
        return False
    if isinstance(value, str) or isinstance(truth, str):
        return value == truth
    absolute, relative = rounding
    return abs(value - truth) <= absolute + relative * max(abs(value), abs(truth))
