"""Lock-out: who gives wrong passwords waits, longer each time; nobody waits for what others have given.

An account from one address is locked first, then that address for all accounts. What comes for an account from many
addresses locks it for all but those from which it has logged in: an engineer may need the page to disarm.
"""

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

from gateway.network import address_origin

FREE_TRIES_OF_PAIR, FREE_TRIES_OF_ADDRESS, FREE_TRIES_OF_ACCOUNT = 5, 20, 50
"""Wrong passwords in a row before an account from one address, an address, or an account from strange addresses is
locked."""
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
        self._failed: OrderedDict[tuple[str, ...], FailedLogins] = OrderedDict()
        self._known: OrderedDict[tuple[str, str], None] = OrderedDict()

    def wait(self, name: str, address: str) -> float:
        """The seconds before a password of this account from this address is looked at; 0 if it is now."""
        now = self._clock()
        keys = self._keys(name, address)
        return max(0.0, *(self._failed[key].locked_until - now for key in keys if key in self._failed), 0.0)

    def failed(self, name: str, address: str) -> bool:
        """Count a wrong password; True where that has locked anything."""
        locked = False
        for key, free in self._keys(name, address).items():
            failed = self._failed.setdefault(key, FailedLogins())
            self._failed.move_to_end(key)
            failed.count += 1
            if failed.count >= free:
                seconds = min(FIRST_LOCK_S * 2 ** min(failed.count - free, 10), LONGEST_LOCK_S)
                failed.locked_until, locked = self._clock() + seconds, True
        while len(self._failed) > MOST_KEPT:
            self._failed.popitem(last=False)
        return locked

    def note_success(self, name: str, address: str) -> None:
        """The right password: the account begins anew. Its address does not, which may know one password of many."""
        known = (name, address_origin(address))
        self._failed.pop(("pair", *known), None)
        self._failed.pop(("account", name), None)
        self._known[known] = None
        self._known.move_to_end(known)
        while len(self._known) > MOST_KEPT:
            self._known.popitem(last=False)

    def _keys(self, name: str, address: str) -> dict[tuple[str, ...], int]:
        """What counts for an account from an address, with how many wrong passwords are free."""
        origin = address_origin(address)
        keys: dict[tuple[str, ...], int] = {("pair", name, origin): FREE_TRIES_OF_PAIR}
        if (name, origin) not in self._known:
            keys |= {("address", origin): FREE_TRIES_OF_ADDRESS, ("account", name): FREE_TRIES_OF_ACCOUNT}
        return keys
