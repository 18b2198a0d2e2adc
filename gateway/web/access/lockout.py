"""Lock-out: who gives wrong passwords waits, longer each time, by account and by address."""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

FREE, FREE_OF_ADDRESS = 5, 20
"""Wrong passwords in a row before an account, or an address for all accounts, is locked."""
FIRST_LOCK_S, LONGEST_LOCK_S = 30.0, 900.0
"""How long it is locked: doubled with each further one, up to the longest."""
MOST_KEPT = 10_000
"""Names and addresses that are remembered: of more, those that failed longest ago are forgotten."""


@dataclass(slots=True)
class FailedLogins:
    """Wrong passwords in a row, and until when (monotonic s) none is looked at."""

    count: int = 0
    locked_until: float = 0.0


class Lockout:
    """Counts wrong passwords; `clock` is monotonic (s)."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._failed: OrderedDict[tuple[str, str], FailedLogins] = OrderedDict()

    def wait(self, name: str, address: str) -> float:
        """The seconds before a password of this account from this address is looked at; 0 if it is now."""
        now = self._clock()
        keys = (("account", name), ("address", address))
        return max(0.0, *(self._failed[key].locked_until - now for key in keys if key in self._failed), 0.0)

    def failed(self, name: str, address: str) -> bool:
        """Count a wrong password; True where that has locked the account or the address."""
        locked = False
        for key, free in ((("account", name), FREE), (("address", address), FREE_OF_ADDRESS)):
            failed = self._failed.setdefault(key, FailedLogins())
            self._failed.move_to_end(key)
            failed.count += 1
            if failed.count >= free:
                seconds = min(FIRST_LOCK_S * 2 ** min(failed.count - free, 10), LONGEST_LOCK_S)
                failed.locked_until, locked = self._clock() + seconds, True
        while len(self._failed) > MOST_KEPT:
            self._failed.popitem(last=False)
        return locked

    def succeeded(self, name: str, address: str) -> None:
        """The right password: the account begins anew. Its address does not, which may know one password of many."""
        self._failed.pop(("account", name), None)
