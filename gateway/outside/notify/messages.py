"""What is said of an alarm to somebody who is away: plain values, a subject and a text."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from hashlib import sha256
from typing import Any

from gateway.settings import alarm_subject


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmMessage:
    """An alarm that was `raised` (s UTC); `state` is the one at that time.

    `machine` is the one that looks after it and at which it is acknowledged, also of an alarm of the whole plant.
    """

    machine: str
    alarm: str
    tag: str
    priority: int
    state: str
    raised: float
    first_up: bool
    response: str
    consequence: str

    @property
    def subject(self) -> str:
        """Whose alarm it is: the plant's or the machine's."""
        return alarm_subject(self.alarm, self.tag, self.machine)

    @property
    def key(self) -> str:
        """What tells this occurrence from every other."""
        return f"{self.machine}\n{self.alarm}\n{self.raised!r}"


def identity(messages: Sequence[AlarmMessage], recipient: str) -> str:
    """The same digits for the same messages to the same recipient: who gets them twice can tell."""
    return sha256("\n\n".join([recipient, *(message.key for message in messages)]).encode()).hexdigest()[:32]


def subject_line(messages: Sequence[AlarmMessage]) -> str:
    """One line: the most urgent alarm, and how many more there are."""
    first = messages[0]
    more = f" and {len(messages) - 1} more" if len(messages) > 1 else ""
    return f"alarm, priority {first.priority}: {first.alarm} ({first.subject}){more}"


def message_text(messages: Sequence[AlarmMessage], *, escalated_after: float) -> str:
    """The alarms for a person, the most urgent first; `escalated_after` minutes nobody had acknowledged them."""
    parts = []
    if escalated_after:
        parts.append(f"Nobody has acknowledged this for {escalated_after:g} minutes.")
    for message in messages:
        moment = datetime.fromtimestamp(message.raised, UTC)
        lines = [
            f"{message.alarm} ({message.subject}), priority {message.priority}",
            f"raised {moment:%Y-%m-%d %H:%M:%S} UTC" + (", first of all that stand" if message.first_up else ""),
            f"what to do: {message.response}" if message.response else "",
            f"otherwise: {message.consequence}" if message.consequence else "",
        ]
        parts.append("\n".join(filter(None, lines)))
    return "\n\n".join(parts) + "\n"


def message_json(messages: Sequence[AlarmMessage], *, recipient: str, escalated_after: float) -> Mapping[str, Any]:
    """The alarms as JSON can carry them."""
    return {
        "id": identity(messages, recipient),
        "subject": subject_line(messages),
        "escalated_after_minutes": escalated_after,
        "alarms": [asdict(message) for message in messages],
    }
