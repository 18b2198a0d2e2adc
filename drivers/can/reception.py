"""What has been heard: the last usable frame of each message and layout, its age, and why others were not used (pure).

A frame of another length than the message's, of a wrong CRC or out of its sequence is no reading. The last usable one
stands until its timeout; after that there is none. Moments are monotonic seconds, given by the caller.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from drivers.can.fields import LayoutCondition, layout_name
from drivers.can.frame import CanFrame
from drivers.can.protection import Count, Protection, check_frame
from drivers.tag import Quality


@dataclass(frozen=True, slots=True)
class MessageRules:
    """How a message is judged: its `name` for sentences, its exact `length` (None: any), its protection if any."""

    key: int
    name: str
    length: int | None = None
    protection: Protection | None = None


@dataclass(slots=True, eq=False)
class Slot:
    """One layout of a message: the last usable frame and the moment when it came; after `timeout` (s) it is too old."""

    name: str
    conditions: tuple[LayoutCondition, ...]
    timeout: float
    frame: CanFrame | None = None
    heard: float = 0.0
    since: float = 0.0

    def fits(self, data: bytes) -> bool:
        """True for a payload of this layout."""
        return all(condition.holds(data) for condition in self.conditions)


@dataclass(slots=True, eq=False)
class Channel:
    """One message of the bus: its rules, its layouts, its counter, and the last frame that could not be used."""

    rules: MessageRules
    slots: list[Slot] = field(default_factory=list)
    count: Count | None = None
    refusal: str = ""
    refused: float = float("-inf")
    refused_count: int = 0

    def take(self, frame: CanFrame, now: float) -> Sequence[Slot]:
        """The layouts that this frame has brought up to date; none if it cannot be used."""
        self.refusal = self._problem(frame.data)
        if self.refusal:
            self.refused = now
            self.refused_count += 1
            return ()
        fresh = [slot for slot in self.slots if slot.fits(frame.data)]
        for slot in fresh:
            slot.frame, slot.heard = frame, now
        return fresh

    def _problem(self, data: bytes) -> str:
        rules = self.rules
        if rules.length is not None and len(data) != rules.length:
            return f"it has {len(data)} bytes, not {rules.length}"
        if rules.protection is None:
            return ""
        self.count, problem = check_frame(rules.protection, self.count, data)
        return problem

    def restart(self, now: float) -> None:
        """Forget what was heard: it is another connection. Where the counter stood is kept.

        So a frame of the former one that an adapter has held back is known by its counter, and is no reading.
        """
        self.refusal, self.refused = "", float("-inf")
        for slot in self.slots:
            slot.frame, slot.since = None, now


class Reception:
    """All messages that are listened for, by the keys of their frames."""

    def __init__(self) -> None:
        self._channels: dict[int, Channel] = {}
        self.since = 0.0
        self.heard: float | None = None
        self.counts = dict.fromkeys(("used", "refused", "unmapped"), 0)

    @property
    def keys(self) -> tuple[int, ...]:
        """The keys of the messages that are listened for."""
        return tuple(self._channels)

    def listen(
        self, rules: MessageRules, conditions: tuple[LayoutCondition, ...], timeout: float, now: float
    ) -> tuple[Channel, Slot]:
        """Listen for a layout of a message from now on; one that is listened for already is given as it is."""
        channel = self._channels.setdefault(rules.key, Channel(rules))
        slot = next((slot for slot in channel.slots if slot.conditions == conditions), None)
        if slot is None:
            slot = Slot(f"{rules.name}{layout_name(conditions)}", conditions, timeout, since=now)
            channel.slots.append(slot)
        return channel, slot

    def take(self, key: int, frame: CanFrame, now: float) -> Sequence[Slot]:
        """The layouts that this frame has brought up to date."""
        channel = self._channels.get(key)
        if channel is None:
            self.counts["unmapped"] += 1
            return ()
        fresh = channel.take(frame, now)
        if fresh:
            self.heard = now
        self.counts["refused" if channel.refusal else "used"] += 1
        return fresh

    def restart(self, now: float) -> None:
        """A new connection: what was heard before it counts no more, and timeouts run from now."""
        self.since, self.heard = now, None
        for channel in self._channels.values():
            channel.restart(now)

    @staticmethod
    def absence(channel: Channel, slot: Slot, now: float) -> tuple[Quality, str] | None:
        """Why the layout has no value at the moment; None if it has one."""
        if slot.frame is not None and now - slot.heard <= slot.timeout:
            return None
        since = slot.since if slot.frame is None else slot.heard
        # Before the first frame the message has as long as between two of them.
        silent = now - since
        # A frame that came and could not be used says more than that none came.
        if channel.refused >= since and channel.refusal:
            return Quality.DECODING_ERROR, f"frame {slot.name} cannot be used: {channel.refusal}"
        if slot.frame is None and silent <= slot.timeout:
            return Quality.WAITING_FOR_INITIAL_DATA, f"frame {slot.name} has not come yet"
        return Quality.TIMEOUT, f"no frame {slot.name} for {silent:.3g} s (limit {slot.timeout:g} s)"

    def longest_timeout(self) -> float:
        """The longest silence (s) that any of the messages may keep; 0 without messages."""
        slots = (slot for channel in self._channels.values() for slot in channel.slots)
        return max((slot.timeout for slot in slots), default=0.0)
