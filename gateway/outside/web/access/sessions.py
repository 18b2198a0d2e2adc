"""Sessions: who is logged in, from which address, until when. They live in memory and end with the gateway."""

import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from hashlib import sha256
from time import monotonic

from gateway.outside.web.access.accounts import Accounts, PageAccount
from gateway.outside.web.access.roles import AccountRole

MAX_SESSION_S = 12 * 3600.0
"""However busy, a person logs in anew once a shift."""
MAX_SESSIONS = 200
"""Sessions at a time: of more, the one that was idle longest ends."""


@dataclass(slots=True)
class Session:
    """One person at one browser; `token` proves that a request comes from our own page (CSRF)."""

    name: str
    address: str
    changed: int
    begun: float
    used: float
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))


class Sessions:
    """Opens, finds and ends sessions by the secret that a browser keeps; only its hash is known here.

    A session ends after `idle_s` without an action of the person, after MAX_SESSION_S, with its account or a change of
    it.
    """

    def __init__(self, accounts: Accounts, idle_s: float, clock: Callable[[], float] = monotonic) -> None:
        self._accounts, self._idle, self._clock = accounts, idle_s, clock
        self._sessions: dict[str, Session] = {}

    def open(self, name: str, account: PageAccount, address: str) -> tuple[str, Session]:
        """A new session and its secret."""
        now, secret = self._clock(), secrets.token_urlsafe(32)
        session = Session(name, address, account.changed, now, now)
        self._sessions[_hash(secret)] = session
        while len(self._sessions) > MAX_SESSIONS:
            del self._sessions[min(self._sessions, key=lambda key: self._sessions[key].used)]
        return secret, session

    def find(self, secret: str, *, use: bool = False) -> tuple[Session, AccountRole] | None:
        """The session of a secret and the role of its account now; None where there is none any more.

        `use`: the person does something, so that the idle time begins anew. Raises AccountsError.
        """
        key, now = _hash(secret), self._clock()
        session = self._sessions.get(key)
        if session is None:
            return None
        account = self._accounts.get(session.name)
        over = now - session.used > self._idle or now - session.begun > MAX_SESSION_S
        if over or account is None or account.changed != session.changed:
            del self._sessions[key]
            return None
        if use:
            session.used = now
        return session, account.role

    def remaining_seconds(self, session: Session) -> float:
        """The seconds after which it ends if nothing is done."""
        now = self._clock()
        return max(min(session.used + self._idle, session.begun + MAX_SESSION_S) - now, 0.0)

    def close(self, secret: str) -> None:
        """End a session."""
        self._sessions.pop(_hash(secret), None)


def _hash(secret: str) -> str:
    return sha256(secret.encode()).hexdigest()
