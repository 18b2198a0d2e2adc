"""`[notify]`: who is told of alarms, by mail or web hook, after which time and of which urgency."""

import re
from collections.abc import Mapping
from ipaddress import ip_address
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator

from drivers.settings import ConfigError, FilePath, Line, Section
from gateway.settings.alarm_kinds import LEAST_URGENT, Priority
from gateway.settings.secrets import read_secrets, token_problems

_ADDRESS = re.compile(r"[\w.!#$%&'*+/=^`{|}~-]{1,64}@(?:[\w-][\w.-]{0,250}|\[[0-9A-Fa-f.:]{2,40}\])")
"""A mail address: an atom with dots at a name, or at an address in brackets."""
LONGEST_ESCALATION = 1440.0
FROM_SECRETS = "secret"
"""The `webhook` of a recipient whose address is in the file of secrets."""


class SmtpSection(Section):
    """`[notify.smtp]`: the mail server."""

    host: str = Field(min_length=1, description="the mail server's name or address")
    port: int = Field(587, ge=1, le=65535, description="a TCP port from 1 to 65535")
    security: Literal["starttls", "tls", "none"] = Field(
        "starttls", description="'starttls', 'tls' (from the first byte) or 'none'"
    )
    user: Line | None = Field(None, description="the name to log in with; its password is in the file of secrets")
    sender: Line = Field(description="the address that messages come from")
    ca: FilePath | None = Field(
        None, description="the certificate of the authority to trust, the system's without this key"
    )

    @model_validator(mode="after")
    def _check_security(self) -> "SmtpSection":
        if self.security == "none" and self.user is not None and not _is_loopback(self.host):
            raise ValueError(
                "security 'none' would send the password in the clear; give 'starttls' or 'tls', or no user"
            )
        return self

    @field_validator("sender")
    @classmethod
    def _an_address(cls, address: str) -> str:
        return _mail_address(address)


class RecipientRow(Section):
    """`[[notify.to]]`: who is told, by mail or by web hook; after some minutes only of what nobody has acknowledged."""

    name: Line = Field(description="the name by which log and status speak of the recipient")
    email: Line | None = Field(None, description="a mail address")
    webhook: str | None = Field(
        None, description=f"an address that begins with https://, or '{FROM_SECRETS}' for one in the file of secrets"
    )
    after: float = Field(
        0.0, ge=0, le=LONGEST_ESCALATION, description="minutes without an acknowledgement, 0 for at once"
    )
    priority: Priority = Field(2, description=f"the least urgent priority to be told of, 1 to {LEAST_URGENT}")

    @field_validator("email")
    @classmethod
    def _an_address(cls, address: str | None) -> str | None:
        return address and _mail_address(address)

    @field_validator("webhook")
    @classmethod
    def _a_web_address(cls, address: str | None) -> str | None:
        return address if address in (None, FROM_SECRETS) else _web_address(address)

    @model_validator(mode="after")
    def _one_way(self) -> "RecipientRow":
        if (self.email is None) == (self.webhook is None):
            raise ValueError(f"{self.name!r} needs either email or webhook; give one of the two")
        return self


class NotifySection(Section):
    """Who is told of alarms; nobody without `[[notify.to]]` tables."""

    secrets: FilePath | None = Field(
        None, description="the file of secrets (TOML, readable by its owner alone), relative to this file"
    )
    smtp: SmtpSection | None = Field(None, description="a [notify.smtp] table with host and sender")
    to: Annotated[tuple[RecipientRow, ...], Field(strict=False)] = Field(
        (), max_length=50, description="[[notify.to]] tables, each with a name and email or webhook"
    )

    @model_validator(mode="after")
    def _check_recipients(self) -> "NotifySection":
        names = [row.name for row in self.to]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(f"{twice!r} is named twice; give each recipient a name of its own")
        if self.smtp is None and any(row.email for row in self.to):
            raise ValueError("mail needs a server; add a [notify.smtp] table with host and sender")
        if self.secrets is None and self.smtp is not None and self.smtp.user is not None:
            raise ValueError("smtp.user needs a password; name the file of secrets (secrets = ...) that has it")
        if self.secrets is None and any(row.webhook == FROM_SECRETS for row in self.to):
            raise ValueError(f"webhook = '{FROM_SECRETS}' needs the file of secrets; name it (secrets = ...)")
        return self


class NotifySecrets(Section):
    """The file of secrets: the mail server's password, and by the recipients' names addresses and tokens."""

    smtp_password: str = Field("", description="the password of smtp.user", repr=False)
    webhooks: Mapping[str, str] = Field({}, description="a table of https:// addresses by recipient", repr=False)
    tokens: Mapping[str, str] = Field({}, description="a table of bearer tokens by recipient", repr=False)


def load_secrets(section: NotifySection) -> NotifySecrets:
    """The secrets of `[notify]`; none without a file.

    Raises ConfigError for one that others may read or that lacks what is needed. What it holds is in no sentence.
    """
    path = section.secrets
    if path is None:
        return NotifySecrets()
    found = read_secrets(NotifySecrets, path, page="docs/alarms.md")
    problems = token_problems(path, found.tokens)
    if section.smtp is not None and section.smtp.user is not None and not found.smtp_password:
        problems.append(f"{path}: smtp_password: is missing; add the password of {section.smtp.user!r}")
    for row in section.to:
        if row.webhook != FROM_SECRETS:
            continue
        try:
            _web_address(found.webhooks[row.name])
        except KeyError:
            problems.append(f"{path}: webhooks: has no address for {row.name!r}; add it")
        except ValueError:
            problems.append(f"{path}: webhooks: that of {row.name!r} is no https:// address; correct it")
    if problems:
        raise ConfigError(problems)
    return found


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _mail_address(address: str) -> str:
    local, _, domain = address.rpartition("@")
    # Without comments, groups, quotes and escapes (RFC 5322, 3.4): what a header says is where the mail goes, then.
    if not _ADDRESS.fullmatch(address) or ".." in address or "." in (local[0], local[-1], domain[0]):
        raise ValueError(f"{address[:60]!r} is no mail address; give one such as 'shift@example.com'")
    return address


def _web_address(address: str) -> str:
    wrong = "give one such as 'https://example.com/alarms'"
    if not address.isascii() or not address.isprintable() or " " in address:
        raise ValueError(f"the address has characters that no address has; {wrong}")
    parts = urlsplit(address)
    try:
        port = parts.port
    except ValueError:
        raise ValueError(f"the address' port is none; {wrong}") from None
    if parts.scheme not in ("http", "https") or not parts.hostname or port == 0:
        raise ValueError(f"{address[:30]!r} is no address of a web hook; {wrong}")
    if parts.username or parts.password:
        raise ValueError("the address holds a password; put it, or a token, into the file of secrets")
    if parts.scheme == "http" and not _is_loopback(parts.hostname):
        raise ValueError(f"{address[:30]!r} would send alarms in the clear; {wrong}")
    return address
