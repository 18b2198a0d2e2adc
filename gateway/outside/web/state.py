"""What the page has in hand to answer with, made once for all requests."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.errors import OneLineError
from gateway.outside.status import GatewayStatus
from gateway.outside.texts import Words
from gateway.outside.web.access import Accounts, Lockout, PasswordChecks, Sessions
from gateway.outside.web.backing_up import BackupMaker
from gateway.outside.web.calls import GatewayCalls
from gateway.outside.web.live import LiveStream
from gateway.outside.web.reader import HistorianReader
from gateway.outside.web.views import machine_view
from gateway.settings import PAGE_SUBJECT, Config
from gateway.store import Audit, AuditEntry


class Unaccountable(OneLineError, RuntimeError):
    """What a person asked for is not done, as it cannot be put on record."""


Mail = Callable[[str, str, float], tuple[list[str], dict[str, str]]]
"""Mails a subject and a text at a time (s UTC) to all who are told by mail; one blocking call. It gives the names of
those who have it, and of the others why not.

Raises OneLineError or ConfigError where nobody could be told at all.
"""


@dataclass(frozen=True, kw_only=True)
class PageState:
    """`config` is any machine's (what the page reads of it is common); `now` gives the plant's time (s UTC)."""

    config: Config
    calls: GatewayCalls
    live: LiveStream
    reader: HistorianReader
    words: Mapping[str, Words]
    accounts: Accounts
    passwords: PasswordChecks
    sessions: Sessions
    audit: Audit
    now: Callable[[], float]
    mail: Mail
    backups: BackupMaker
    lockout: Lockout = field(default_factory=Lockout)

    @property
    def reading_is_open(self) -> bool:
        """Whether one may read without an account."""
        return self.config.page.loopback and self.config.page.open_reading

    def show(self, language: str, status: GatewayStatus) -> dict[str, Any]:
        """What a browser of a language is shown of a machine."""
        return machine_view(self.words[language], self.config.page.labels, status)

    async def plant(self, language: str) -> dict[str, Any]:
        """All machines as they are now, taken for this. Raises ControlError."""
        statuses = await self.calls.plant()
        taken = time.time()
        shown = {name: {"taken": taken, **self.show(language, status)} for name, status in statuses.items()}
        return {"order": list(statuses), "machines": shown}

    async def record(self, kind: str, who: str, reason: str = "", **detail: Any) -> None:
        """Have on the disk what is going to be done, by whom and from where. Raises Unaccountable."""
        entry = AuditEntry(self.now(), kind, who, reason, detail).with_subject(PAGE_SUBJECT)
        if await self.audit.stored(entry) is None:
            raise Unaccountable(f"it cannot be put on record: {self.audit.failure or 'the audit log does not answer'}")

    def note(self, kind: str, who: str, reason: str = "", **detail: Any) -> None:
        """Have something put on record that has happened already."""
        self.audit.put(AuditEntry(self.now(), kind, who, reason, detail).with_subject(PAGE_SUBJECT))
