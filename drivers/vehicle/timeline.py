"""When a recorded frame is played: logged times to a line that only goes forward (pure)."""

from dataclasses import dataclass, field

JITTER = 1.0
"""Seconds by which logged times may step back as buses are written in turn; more is a clock that was set back."""
AFTER_END = 1.0
"""Seconds between the last frame of a log and its first one when it is played anew."""


@dataclass(slots=True)
class Timeline:
    """Seconds since the first frame; a pause longer than `max_gap` (s) is played as `max_gap` long.

    A clock that was set back goes on without a pause. Counted: steps `back`, and pauses that were `shortened`.
    """

    max_gap: float
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(("back", "shortened"), 0))
    _shift: float | None = None
    _played: float = 0.0

    def at(self, logged: float) -> float:
        """The frame's moment on the line: never before the one given last."""
        if self._shift is None:
            self._shift = self._played - logged
        step = logged + self._shift - self._played
        if step < 0.0:
            self.counts["back"] += 1
        if step < -JITTER:
            self._shift -= step
        elif step > self.max_gap:
            self.counts["shortened"] += 1
            self._shift -= step - self.max_gap
        self._played = max(self._played, logged + self._shift)
        return self._played

    def again(self) -> None:
        """The log begins anew."""
        self._shift = None
        self._played += AFTER_END
