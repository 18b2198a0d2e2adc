"""Looking at a running gateway again and again; what it does not say any more is never passed on as present."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic

from gateway.outside.status.client import ControlError, GatewayLine
from gateway.outside.status.picture import GatewayStatus, read_status

PRESENT_S = 2.0
"""How old (real s) a status may be that is shown as the present one, counted from when it was asked for."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """What is known of a gateway now: its newest status, and how long ago (real s) that was asked for.

    `status` is that of the machine that is looked at, None where all of several are: `machines` has them by name.
    `silence` says why the status is not a present one, "" while it is. `gone`: nobody listens at the socket.
    """

    status: GatewayStatus | None
    age: float
    silence: str = ""
    gone: bool = False
    machines: Mapping[str, GatewayStatus] = field(default_factory=dict)


class GatewayWatch:
    """Asks the gateway at `path` for the status of a `machine`, or of all, over one connection.

    `clock` is monotonic (s).

    The age of a status counts from the request: a reply that waited in the socket while this program was stopped is as
    old as it is.
    """

    def __init__(self, path: Path, clock: Callable[[], float] = monotonic, *, machine: str | None = None) -> None:
        self.path, self._machine = path, machine
        self._clock = clock
        self._line: GatewayLine | None = None
        self._requested: float | None = None  # of the request that has no reply yet
        self._statuses: dict[str, GatewayStatus] = {}
        self._asked = clock()  # of the newest status; before the first, since when one is waited for

    def look(self, patience: float) -> Sighting:
        """Ask, and wait for the reply for `patience` seconds at most. Raises StatusError, ControlError if refused."""
        try:
            # A reply that is too old by the time it is read is followed by a second request.
            for _ in range(2):
                self._take(patience)
                if self._clock() - self._asked <= PRESENT_S:
                    break
        except (TimeoutError, BlockingIOError):
            pass  # it listens and does not answer; BlockingIOError: it does not even accept
        except OSError as error:
            self.close()
            return self._sighting(_absence_reason(self.path, error), gone=True)
        late = not self._statuses or self._clock() - self._asked > PRESENT_S
        return self._sighting(f"the gateway at {self.path} is there and does not answer" if late else "")

    def _sighting(self, silence: str, *, gone: bool = False) -> Sighting:
        known = self._statuses
        only = next(iter(known.values())) if len(known) == 1 else None
        return Sighting(only, self._clock() - self._asked, silence, gone, known)

    def _take(self, patience: float) -> None:
        if self._line is None:
            self._line = GatewayLine(self.path, max(patience, 0.1))
        if self._requested is None:
            self._requested = self._clock()
            self._line.send("plant")
        try:
            reply = self._line.reply(max(patience, 0.001))
        except ControlError:
            self.close()
            raise
        asked, self._requested = self._requested, None
        answered = reply.get("statuses")
        statuses = {name: read_status(plain) for name, plain in answered.items()} if isinstance(answered, dict) else {}
        if self._machine is not None and self._machine not in statuses:
            raise ControlError(f"there is no machine {self._machine!r}; this gateway has {', '.join(statuses)}")
        chosen = statuses if self._machine is None else {self._machine: statuses[self._machine]}
        self._statuses, self._asked = chosen, asked

    def close(self) -> None:
        """Let the connection go; the next look makes a new one."""
        if self._line is not None:
            self._line.close()
        self._line = self._requested = None


def _absence_reason(path: Path, error: OSError) -> str:
    if isinstance(error, FileNotFoundError | ConnectionRefusedError):
        return f"no gateway runs (nothing listens at {path})"
    if isinstance(error, PermissionError | ConnectionResetError):
        return f"the gateway at {path} does not speak to this user, or has just ended"
    return f"no gateway can be asked at {path} ({(error.strerror or str(error)).lower()})"
