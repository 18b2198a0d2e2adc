"""Who is told of which alarm, and when: at once, again until it is delivered, the next one if nobody acknowledges.

A scan only leaves a note (`take`): a thread for each recipient does the talking, so that none waits for another. What
is not delivered yet, and who knows already of an alarm that still waits, is kept in the historian, so that a restart
neither forgets a message nor sends it anew. A message is delivered at least once: a gateway that is killed between a
server's answer and the next commit of its records sends that one again, under the same Message-ID or Idempotency-Key.

Policy of the queue: MAX_WAITING_DELIVERIES deliveries wait at most. Beyond that the oldest of the least urgent is given
up, counted and logged, and so is one that is older than a day.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from time import monotonic
from typing import TYPE_CHECKING, Any

from drivers.supervision import Supervisor
from gateway.machine.alarms import UNSEEN, Alarm, AlarmCondition, AlarmState
from gateway.outside.notify.messages import AlarmMessage
from gateway.outside.notify.senders import RefusedError, Sender, UndeliveredError
from gateway.settings import RecipientRow
from gateway.store import HistorianView, saved_state

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

    from gateway.machine import Machine

MAX_WAITING_DELIVERIES = 500
MAX_ALARMS_PER_MESSAGE = 50
"""Alarms in one message: what comes while a server is talked to goes out together."""
FIRST_RETRY, LONGEST_RETRY = 1.0, 300.0
"""Seconds until a recipient is tried again: doubled with each failure up to the longest."""
MESSAGE_GAP_SECONDS = 5.0
"""Seconds between two messages to one recipient: an alarm that chatters fills no mailbox."""
COMPLAIN_SECONDS = 60.0
"""What was asked for and is not delivered for so long is a cause for complaint, whatever keeps it."""
OLDEST_SECONDS = 86_400.0
CLOSE_SECONDS = 2.0


@dataclass(frozen=True, slots=True)
class Delivery:
    """A message to a recipient that is `due` at a monotonic time (s), and was asked for at `made`."""

    message: AlarmMessage
    recipient: str
    due: float
    made: float

    @property
    def key(self) -> tuple[str, str]:
        """What tells it from every other."""
        return self.message.key, self.recipient


@dataclass(slots=True)
class RecipientLine:
    """How it goes with one recipient; `failing_since` and `again` are monotonic (s)."""

    row: RecipientRow
    send: Sender
    failing_since: float | None = None
    again: float = 0.0
    pause: float = FIRST_RETRY
    reason: str = ""


class Notifier:
    """Tells the recipients of a gateway's alarms, from its making until `close`.

    `senders` are the ways to the recipients of `rows`, by name; `now` is the plant's clock (s UTC), `clock` a monotonic
    one (s). `delivered` and `given_up` count messages.
    """

    def __init__(
        self,
        rows: Iterable[RecipientRow],
        senders: Mapping[str, Sender],
        *,
        now: Callable[[], float],
        supervisor: Supervisor,
        log: FilteringBoundLogger,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._lines = {row.name: RecipientLine(row, senders[row.name]) for row in rows}
        self._now, self._clock, self._log = now, clock, log
        self._historians: dict[str, HistorianView] = {}
        self._waiting: dict[tuple[str, str], Delivery] = {}
        self._known: dict[tuple[str, str], AlarmMessage] = {}
        self._unseen: set[tuple[str, str]] = set()
        self._wake = threading.Condition()
        self._stop = threading.Event()
        self._changed: set[str] = set()
        self.delivered = self.given_up = 0
        self._threads = [
            supervisor.thread(f"notification {name}", partial(self._work, line), stop=self._stop)
            for name, line in self._lines.items()
        ]

    @property
    def complaint(self) -> str:
        """Which recipient lacks what it was to be told a while ago, or cannot be reached, and why; "" none."""
        since = self._clock() - COMPLAIN_SECONDS
        overdue = {each.recipient for each in tuple(self._waiting.values()) if each.due <= since}
        return "; ".join(
            f"{name}: {line.reason or 'not delivered yet'}"
            for name, line in self._lines.items()
            if name in overdue or (line.failing_since is not None and line.failing_since <= since)
        )

    @property
    def waiting(self) -> int:
        """The deliveries that wait for their time or for their recipient."""
        return len(self._waiting)

    def attach(
        self,
        machine: str,
        historian: HistorianView,
        unseen: Iterable[tuple[AlarmCondition, Alarm]],
        *,
        known: Collection[str],
    ) -> None:
        """Begin with a machine: what its historian has to be sent yet, then what its `unseen` alarms ask for.

        Of an alarm that is not among those `known` any more nobody is told: it would never be acknowledged.
        """
        saved = saved_state(historian, "messages", self._log)
        with self._wake:
            self._historians[machine] = historian
            if saved is not None and not any(self._key_machine(key) == machine for key in self._waiting):
                self._restore(saved[1], self._now() - saved[0], known)
        for condition, alarm in unseen:
            if alarm.raised is not None:
                self._queue_message(machine, condition, alarm, self._now() - alarm.raised)

    def take(self, machine: str, condition: AlarmCondition, before: Alarm, after: Alarm) -> None:
        """Note a change of an alarm; it waits for nothing.

        What comes again before anybody has acknowledged it is what everybody was told already.
        """
        if after.state is AlarmState.UNACKNOWLEDGED and before.state not in UNSEEN:
            self._queue_message(machine, condition, after, 0.0)
        elif before.state in UNSEEN and after.state not in UNSEEN:
            # Somebody knows: nobody else has to be told who was not to be told at once.
            with self._wake:
                for key, delivery in list(self._waiting.items()):
                    message, row = delivery.message, self._lines[delivery.recipient].row
                    if (message.machine, message.alarm) == (machine, after.condition) and row.after > 0:
                        del self._waiting[key]
                for key, message in list(self._known.items()):
                    if (message.machine, message.alarm) == (machine, after.condition):
                        del self._known[key]
                self._unseen.discard((machine, after.condition))
                self._changed.add(machine)
                self._wake.notify_all()

    def _queue_message(self, machine: str, condition: AlarmCondition, alarm: Alarm, age: float) -> None:
        """Have everybody told, in their time, of an alarm that has been waiting for `age` seconds.

        At a start it may have come again since those were told who know of it.
        """
        message = AlarmMessage(
            machine=machine,
            alarm=condition.name,
            tag=condition.tag,
            priority=condition.priority,
            state=alarm.state.value,
            raised=alarm.since if alarm.raised is None else alarm.raised,
            first_up=alarm.first_up,
            response=condition.response,
            consequence=condition.consequence,
        )
        with self._wake:
            now = self._clock()
            self._unseen.add((machine, condition.name))
            for line in self._lines.values():
                key = (message.key, line.row.name)
                known = key in self._waiting or any(
                    recipient == line.row.name and (told.machine, told.alarm) == (machine, condition.name)
                    for (_, recipient), told in self._known.items()
                )
                if condition.priority <= line.row.priority and not known:
                    due = now + max(line.row.after * 60.0 - max(age, 0.0), 0.0)
                    self._waiting[key] = Delivery(message, line.row.name, due, now)
            self._changed.add(machine)
            self._drop_excess()
            self._wake.notify_all()

    def _drop_excess(self) -> None:
        """Give up what is too much, and what is too old."""
        now = self._clock()
        lost = [key for key, delivery in self._waiting.items() if now - delivery.due > OLDEST_SECONDS]
        by_worth = sorted(
            self._waiting, key=lambda key: (-self._waiting[key].message.priority, self._waiting[key].made)
        )
        lost += [key for key in by_worth if key not in lost][
            : max(len(self._waiting) - len(lost) - MAX_WAITING_DELIVERIES, 0)
        ]
        for key in lost:
            delivery = self._waiting.pop(key)
            self.given_up += 1
            self._log.error(
                "a message about an alarm was given up",
                recipient=delivery.recipient,
                alarm=delivery.message.alarm,
                given_up=self.given_up,
            )

    # ---------------------------------------------------------------- the threads, one a recipient

    def _work(self, line: RecipientLine) -> None:
        while True:
            with self._wake:
                pause = self._pause(line)
                if pause > 0 and not self._stop.is_set() and not self._changed:
                    self._wake.wait(pause)
                self._drop_excess()
                changed, self._changed = self._changed, set()
                self._save(changed)
                batch = self._next(line)
            if self._stop.is_set():
                return
            if batch:
                self._deliver(line, batch)

    def _pause(self, line: RecipientLine) -> float:
        """Seconds until there is something to do for a recipient."""
        dues = [max(each.due, line.again) for each in self._waiting.values() if each.recipient == line.row.name]
        return min(max(min(dues, default=float("inf")) - self._clock(), 0.0), 60.0)

    def _next(self, line: RecipientLine) -> list[Delivery]:
        """What a recipient is told now, urgent first."""
        now = self._clock()
        if line.again > now:
            return []
        ready = [each for each in self._waiting.values() if each.recipient == line.row.name and each.due <= now]
        return sorted(ready, key=lambda each: (each.message.priority, each.message.raised))[:MAX_ALARMS_PER_MESSAGE]

    def _deliver(self, line: RecipientLine, batch: list[Delivery]) -> None:
        name = line.row.name
        try:
            line.send([each.message for each in batch], self._now())
        except UndeliveredError as error:
            now = self._clock()
            line.again, line.pause = now + line.pause, min(line.pause * 2.0, LONGEST_RETRY)
            line.failing_since = now if line.failing_since is None else line.failing_since
            if str(error) != line.reason:
                line.reason = str(error)
                self._log.warning("a message about an alarm is not delivered yet", recipient=name, reason=line.reason)
            return
        except RefusedError as error:
            line.reason, line.failing_since = str(error), line.failing_since or self._clock() - COMPLAIN_SECONDS
            self._log.error("a message about an alarm is refused", recipient=name, reason=line.reason)
            delivered = False
        else:
            if line.reason:
                self._log.info("messages about alarms are delivered again", recipient=name)
            line.failing_since, line.pause, line.reason = None, FIRST_RETRY, ""
            line.again = self._clock() + MESSAGE_GAP_SECONDS
            delivered = True
        with self._wake:
            for each in batch:
                # Acknowledged meanwhile, it may be gone already.
                self._waiting.pop(each.key, None)
                if (each.message.machine, each.message.alarm) in self._unseen:
                    self._known[each.key] = each.message
                self._changed.add(each.message.machine)
            self.delivered += len(batch) if delivered else 0
            self.given_up += 0 if delivered else len(batch)

    # ---------------------------------------------------------------- what outlives it

    def _key_machine(self, key: tuple[str, str]) -> str:
        return key[0].partition("\n")[0]

    def _save(self, machines: Iterable[str]) -> None:
        now = self._clock()
        for machine in machines:
            historian = self._historians.get(machine)
            if historian is None:
                continue
            waiting = [
                {"message": asdict(each.message), "recipient": each.recipient, "left": each.due - now}
                for key, each in self._waiting.items()
                if self._key_machine(key) == machine
            ]
            known = [
                {"message": asdict(message), "recipient": key[1]}
                for key, message in self._known.items()
                if self._key_machine(key) == machine
            ]
            historian.save("messages", self._now(), {"waiting": waiting, "known": known})

    def _restore(self, saved: Mapping[str, Any], ago: float, alarms: Collection[str]) -> None:
        now = self._clock()
        try:
            for row in saved["waiting"]:
                message, recipient = AlarmMessage(**row["message"]), str(row["recipient"])
                if recipient in self._lines and message.alarm in alarms:
                    due = now + max(float(row["left"]) - max(ago, 0.0), 0.0)
                    self._waiting[message.key, recipient] = Delivery(message, recipient, due, now)
            for row in saved["known"]:
                message = AlarmMessage(**row["message"])
                if message.alarm in alarms:
                    self._known[message.key, str(row["recipient"])] = message
        except (KeyError, TypeError, ValueError) as error:
            self._log.warning("messages that were not delivered cannot be read and are not sent", reason=repr(error))

    def close(self) -> None:
        """Stop telling; what waits is kept for the next start. A delivery under way ends by itself."""
        with self._wake:
            self._stop.set()
            self._save(self._historians)
            self._wake.notify_all()
        end = monotonic() + CLOSE_SECONDS
        for thread in self._threads:
            thread.join(max(end - monotonic(), 0.0))


def attach_machine(notifier: Notifier, machine: Machine) -> None:
    """Let the notifier hear of a machine's alarms."""
    name, board = machine.config.machine, machine.alarms
    unseen = [(board.conditions[each], board.alarms[each]) for each in board.waiting()]
    notifier.attach(name, machine.historian, unseen, known=frozenset(board.conditions))
    board.listeners.append(lambda condition, before, after: notifier.take(name, condition, before, after))
