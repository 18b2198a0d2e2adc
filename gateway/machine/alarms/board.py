"""The alarms of one machine: what was measured and what the model finds move them, the PLC's bits acknowledge them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from gateway.machine.alarms.states import (
    Alarm,
    AlarmCondition,
    AlarmState,
    Change,
    acknowledge,
    from_plain,
    moved,
    new_alarm,
    step,
    to_plain,
    word,
)
from gateway.machine.reading import Scan
from gateway.store import HistorianView, saved_state

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger


class AlarmBoard:
    """All alarms of a machine, in two stages of a scan: `on_measured` before the model, `on_predictions` after it.

    What changes is on record and in the log at once: an alarm waits for nothing that comes later in the scan. The
    alarms go on as they were when the gateway last ran; what cannot be read begins as normal, and is logged. `words`
    are the PLC's words of acknowledge bits, by tag, each with the temperatures whose alarms it acknowledges.
    """

    def __init__(
        self,
        conditions: Mapping[str, AlarmCondition],
        *,
        watched: Sequence[str],
        words: Mapping[str, frozenset[str]],
        historian: HistorianView,
        log: FilteringBoundLogger,
        now: float,
    ) -> None:
        self.conditions, self.watched, self._words = conditions, watched, words
        self._historian, self._log = historian, log
        self._acknowledged: dict[str, int | None] = {}
        self.alarms = {name: new_alarm(condition, now) for name, condition in conditions.items()}
        saved = saved_state(historian, "alarms", log) or (now, {})
        for name, plain in saved[1].items():
            if name in conditions:
                try:
                    self.alarms[name] = from_plain(conditions[name], plain)
                except (KeyError, TypeError, ValueError) as error:
                    log.warning("a saved alarm cannot be read and begins as normal", alarm=name, reason=str(error))

    def word(self, temperature: str) -> int:
        """The alarm word of the block of a temperature."""
        return word(self.conditions, self.alarms, temperature)

    def on_measured(self, scan: Scan) -> None:
        """The PLC's acknowledge bits, then the thresholds: they need neither model nor forecast."""
        for tag, temperatures in self._words.items():
            bits = scan.good(tag)
            if bits is not None:
                before = dict(self.alarms)
                own = {
                    name: condition
                    for name, condition in self.conditions.items()
                    if not condition.temperature or condition.temperature in temperatures
                }
                former = self._acknowledged.get(tag)
                self.alarms |= acknowledge(
                    own,
                    {name: before[name] for name in own if name in before},
                    before=former,
                    bits=int(bits),
                    now=scan.time,
                    by="PLC",
                )
                for name, alarm in self.alarms.items():
                    self._note(before[name], alarm, None, scan.time)
            # Bits that could not be read leave no edge to be seen when they can be again.
            self._acknowledged[tag] = None if bits is None else int(bits)
        self._step({f"over limit {name}": scan.good(name) for name in self.watched}, scan.time)

    def acknowledge(self, name: str, by: str, now: float) -> AlarmState:
        """A person's acknowledgement of an alarm, between two scans; gives its state then. Raises KeyError."""
        before = self.alarms[name]
        self.alarms[name] = moved(before, Change.ACKNOWLEDGE, now, by)
        self._note(before, self.alarms[name], None, now)
        return self.alarms[name].state

    def on_predictions(self, scan: Scan, findings: Mapping[str, float | None]) -> None:
        """What the model finds, and without one that an input is bad; None for what is not known."""
        if "inputs bad" not in findings:
            bad = any(scan.good(name) is None for name in self.watched)
            findings = {"inputs bad": float(bad), **findings}
        self._step(findings, scan.time)

    def _step(self, values: Mapping[str, float | None], now: float) -> None:
        for name, value in values.items():
            before = self.alarms[name]
            self.alarms[name] = step(self.conditions[name], before, value, now)
            self._note(before, self.alarms[name], value, now)

    def _note(self, before: Alarm, after: Alarm, value: float | None, now: float) -> None:
        if after.state is before.state:
            return
        self._historian.save("alarms", now, {name: to_plain(alarm) for name, alarm in self.alarms.items()})
        row = (now, after.condition, after.tag, after.priority, after.state.value, value, after.acknowledged_by)
        self._historian.put("alarms", [row])
        response = self.conditions[after.condition].response if after.active else ""
        self._log.warning("alarm", condition=after.condition, state=after.state.value, value=value, response=response)
