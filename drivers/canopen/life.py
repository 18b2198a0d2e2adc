"""The life counter in PDOs: who has sent a frame, and how old what it says is.

CAN does not say who has sent a frame. A device whose program counts in an object that every TPDO carries can be told
from a stranger, a babbling or a misconfigured node: the counter goes on by no more than `rate` a second. And a frame
that repeats a count says nothing newer than the first frame with it, as from a device whose program stands still.
"""

from dataclasses import dataclass

from drivers.canopen.place import ObjectPlace

MAX_LATENESS_S = 0.05
"""Seconds by which a frame may be late on its way without being taken for a stranger's."""
ALERT_S = 1.0
"""Seconds after a stranger's frame in which no lateness is forgiven: a guess must meet the very next counts."""
MIN_CONFIRMING_FRAMES = 3
"""Frames in a row that must continue one another before another course of the counter is believed."""
_COUNTER_MODULUS = 0xFFFF  # 1..65535 and round to 1; 0: the program does not run


@dataclass(slots=True)
class _Course:
    value: int
    moment: float

    def continues(self, value: int, moment: float, rate: float, jitter: float) -> bool:
        if 0 in (value, self.value):  # the program has stopped, or has begun anew
            return value == self.value
        # One step more than the time allows: the count may have been due just as the last frame was sent.
        step = (value - self.value) % _COUNTER_MODULUS
        return step <= rate * (max(moment - self.moment, 0.0) + jitter) + 1


@dataclass(slots=True)
class Life:
    """The counter of one node: 16 bits at `place`, at most `rate` steps a second.

    `since` is when the present count was first heard: time by the driver's clock, and moment by the loop's.
    """

    place: ObjectPlace
    rate: float
    strangers: int = 0
    since: tuple[float, float] = (0.0, 0.0)
    _course: _Course | None = None
    _other: _Course | None = None
    _confirmed: int = 0
    _stranger: float = -ALERT_S

    def anchor(self, value: int, moment: float) -> None:
        """The counter's value is known by other means (SDO)."""
        self._course, self._other, self._confirmed = _Course(value, moment), None, 0

    def forget(self) -> None:
        """The node has begun anew."""
        self._course, self._other, self._confirmed, self.since = None, None, 0, (0.0, 0.0)

    def own(self, value: int, time: float, moment: float) -> bool:
        """True if a frame with this count, heard at this time and moment, can be the node's."""
        before = self._course.value if self._course is not None and self.since[1] else None
        believed = self._accepts(value, moment)
        if believed and value != before:
            self.since = (time, moment)
        return believed

    def _accepts(self, value: int, moment: float) -> bool:
        # A stranger who guesses meets the window of a plain frame now and then; just after a wrong guess it is closed.
        jitter = 0.0 if moment - self._stranger < ALERT_S else MAX_LATENESS_S
        if self._course is not None and self._course.continues(value, moment, self.rate, jitter):
            self.anchor(value, moment)
            return True
        # The node itself may have begun anew unheard: frames that continue one another are believed in the end.
        if self._other is not None and self._other.continues(value, moment, self.rate, jitter):
            self._confirmed += 1
        else:
            self._confirmed = 1
        self._other = _Course(value, moment)
        if self._confirmed >= MIN_CONFIRMING_FRAMES:
            self.anchor(value, moment)
            return True
        self.strangers += 1
        self._stranger = moment
        return False
