"""The ways to a recipient: a mail server, a web hook. Each is one blocking call that delivers or says why not.

No sentence here holds a password, a token or the address of a web hook, which may be a secret too.
"""

import json
import smtplib
import socket
from collections.abc import Callable, Mapping, Sequence
from email.message import EmailMessage
from email.utils import formatdate
from functools import partial
from hashlib import sha256
from http.client import HTTPException
from time import monotonic
from urllib.parse import urlsplit

from drivers.errors import OneLineError
from gateway.network import TimedHttp, TimedTls, call_with_deadline, connect, failure_reason, make_tls
from gateway.outside.notify.messages import AlarmMessage, identity, message_json, message_text, subject_line
from gateway.settings import FROM_SECRETS, NotifySecrets, NotifySection, RecipientRow, SmtpSection

DELIVERY_SECONDS = 30.0
"""Seconds for a delivery in all, from the server's name to its last word: half of what is complained of."""
NAME_SECONDS = 5.0
"""Seconds that this computer's own name may take; without it the delivery goes on under an address."""
MOST_ANSWER_BYTES = 1 << 20
"""Bytes of all that a server says during a delivery."""
_TRY_AGAIN = frozenset({408, 425, 429})
"""HTTP's 4xx that say "later" (RFC 9110, RFC 6585, RFC 8470)."""


class UndeliveredError(OneLineError):
    """It was not delivered and may be the next time; the message is one sentence."""


class RefusedError(OneLineError):
    """It was refused for good: trying again would not help."""


Sender = Callable[[Sequence[AlarmMessage], float], None]
"""Delivers messages at a time (s UTC). Raises UndeliveredError or RefusedError."""


def make_senders(section: NotifySection, secrets: NotifySecrets) -> dict[str, Sender]:
    """The way to each recipient by name. Raises OSError (ssl.SSLError too) for an authority that cannot be read."""
    senders: dict[str, Sender] = {}
    for row in section.to:
        if row.email is not None and section.smtp is not None:
            smtp = section.smtp
            senders[row.name] = partial(_mail, row, smtp, secrets.smtp_password, make_tls(smtp.ca))
        else:
            address = secrets.webhooks[row.name] if row.webhook == FROM_SECRETS else str(row.webhook)
            senders[row.name] = partial(_post, row, address, secrets.tokens.get(row.name, ""))
    return senders


class _TimedSmtp(smtplib.SMTP):
    """A mail server, talked to until `end` (monotonic s); encrypted from the first byte with a context."""

    def __init__(self, host: str, port: int, *, end: float, tls: TimedTls | None) -> None:
        self._end, self._tls = end, tls
        # smtplib would ask for this computer's name by itself, and wait for the answer as long as it takes.
        super().__init__(host, port, local_hostname=_own_name(end))

    def _get_socket(self, host: str, port: int, _timeout: float) -> socket.socket:
        line = connect(host, port, self._end)
        line.room = MOST_ANSWER_BYTES
        return line if self._tls is None else self._tls.wrap_socket(line, server_hostname=host)


def _own_name(end: float) -> str:
    """What this computer calls itself to a mail server (RFC 5321, 4.1.4): its full name, or else an address.

    A name server that does not answer costs a part of the time until `end` (monotonic s), and no delivery.
    """
    try:
        name = call_with_deadline(min(end, monotonic() + NAME_SECONDS), socket.getfqdn)
    except (OSError, ValueError):
        name = ""
    return name if "." in name else "[127.0.0.1]"


def mail_text(
    section: NotifySection, secrets: NotifySecrets, subject: str, text: str, now: float
) -> tuple[list[str], dict[str, str]]:
    """Mail a text at a time (s UTC) to each recipient that has an address; gives the names of those who have it, and of
    the others why not. Raises UndeliveredError where the server's authority cannot be read.
    """
    told, missed, smtp = list[str](), dict[str, str](), section.smtp
    if smtp is None:
        return told, missed
    try:
        trusted = make_tls(smtp.ca)
    except OSError as error:
        raise UndeliveredError(f"smtp.ca {smtp.ca} cannot be read ({failure_reason(error)})") from None
    for row in section.to:
        if row.email is None:
            continue
        mark = sha256("\n\n".join([row.name, subject, text, repr(now)]).encode()).hexdigest()[:32]
        try:
            _send_mail(row, smtp, secrets.smtp_password, trusted, subject=subject, text=text, mark=mark, now=now)
        except (UndeliveredError, RefusedError) as error:
            missed[row.name] = str(error)
        else:
            told.append(row.name)
    return told, missed


def _mail(
    row: RecipientRow,
    smtp: SmtpSection,
    password: str,
    trusted: TimedTls,
    messages: Sequence[AlarmMessage],
    now: float,
) -> None:
    text, mark = message_text(messages, escalated_after=row.after), identity(messages, row.name)
    _send_mail(row, smtp, password, trusted, subject=subject_line(messages), text=text, mark=mark, now=now)


def _send_mail(
    row: RecipientRow,
    smtp: SmtpSection,
    password: str,
    trusted: TimedTls,
    *,
    subject: str,
    text: str,
    mark: str,
    now: float,
) -> None:
    """A mail whose Message-ID has a `mark`: one that is sent twice can be told by it."""
    end = monotonic() + DELIVERY_SECONDS
    try:
        mail = EmailMessage()
        mail["From"], mail["To"], mail["Subject"] = smtp.sender, row.email, subject
        mail["Date"] = formatdate(now)
        mail["Message-ID"] = f"<{mark}@decanter.invalid>"
        mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: nobody's holiday answers it
        mail.set_content(text)
        with _TimedSmtp(smtp.host, smtp.port, end=end, tls=trusted if smtp.security == "tls" else None) as server:
            if smtp.security == "starttls":
                server.starttls(context=trusted)
            if smtp.user is not None:
                server.login(smtp.user, password)
            server.send_message(mail)
    except smtplib.SMTPRecipientsRefused as error:
        code = next(iter(error.recipients.values()))[0]
        raise _refusal(code, f"the mail server does not take the address ({code})") from None
    except smtplib.SMTPAuthenticationError as error:
        # A password can be put right while the message waits.
        raise UndeliveredError(f"the mail server refuses smtp.user ({error.smtp_code})") from None
    except smtplib.SMTPResponseException as error:
        raise _refusal(error.smtp_code, f"the mail server answers {error.smtp_code}") from None
    except smtplib.SMTPNotSupportedError:
        raise UndeliveredError("the mail server offers no such encryption or login") from None
    except (OSError, smtplib.SMTPException) as error:
        raise UndeliveredError(f"the mail server cannot be used ({_reason(error, end)})") from None
    except ValueError:  # a name or an address that no header holds; of TLS it would be an OSError too
        raise RefusedError("it cannot be written as a mail") from None


def _refusal(code: int, sentence: str) -> Exception:
    """SMTP's 5xx are for good, its 4xx for now (RFC 5321, 4.2.1); smtplib has -1 for what is no code."""
    if code < 0:
        return UndeliveredError("the mail server's answer is none of SMTP's")
    return RefusedError(sentence) if code >= 500 else UndeliveredError(sentence)


def _post(row: RecipientRow, address: str, token: str, messages: Sequence[AlarmMessage], _: float) -> None:
    parts = urlsplit(address)
    host, path = str(parts.hostname), (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    end = monotonic() + DELIVERY_SECONDS
    line = TimedHttp(host, parts.port, make_tls(None) if parts.scheme == "https" else None)
    line.allow(DELIVERY_SECONDS, MOST_ANSWER_BYTES)
    plain = message_json(messages, recipient=row.name, escalated_after=row.after)
    headers: Mapping[str, str] = {"Content-Type": "application/json", "Idempotency-Key": str(plain["id"])}
    headers = {**headers, **({"Authorization": f"Bearer {token}"} if token else {})}
    try:
        line.request("POST", path, body=json.dumps(plain).encode(), headers=headers)
        status = line.getresponse().status
    except (OSError, HTTPException) as error:
        raise UndeliveredError(f"the web hook cannot be reached ({_reason(error, end)})") from None
    except ValueError:  # what it says quotes the token
        raise RefusedError("its token or address cannot be sent") from None
    finally:
        line.close()
    if 200 <= status < 300:
        return
    sentence = f"the web hook answers {status}"
    if status >= 500 or status in _TRY_AGAIN:
        raise UndeliveredError(sentence)
    raise RefusedError(sentence)


def _reason(error: Exception, end: float) -> str:
    """What an error says without quoting what was sent or asked for; after `end` (monotonic s) it was too late."""
    return "no answer in time" if monotonic() >= end else failure_reason(error)
