"""The ways to a recipient: a mail server, a web hook. Each is one blocking call that delivers or says why not.

No sentence here holds a password, a token or the address of a web hook, which may be a secret too.
"""

import json
import smtplib
import ssl
from collections.abc import Callable, Mapping, Sequence
from email.message import EmailMessage
from email.utils import formatdate
from functools import partial
from http.client import HTTPConnection, HTTPException, HTTPSConnection
from urllib.parse import urlsplit

from gateway.notify.messages import AlarmMessage, identity, plain_of, subject_of, text_of
from gateway.settings import FROM_SECRETS, NotifySecrets, NotifySection, RecipientRow, SmtpSection

TIMEOUT = 10.0
"""Seconds for each step of a delivery."""
_TRY_AGAIN = frozenset({408, 425, 429})
"""HTTP's 4xx that say "later" (RFC 9110, RFC 6585, RFC 8470)."""


class UndeliveredError(Exception):
    """It was not delivered and may be the next time; the message is one sentence."""


class RefusedError(Exception):
    """It was refused for good: trying again would not help."""


Sender = Callable[[Sequence[AlarmMessage], float], None]
"""Delivers messages at a time (s UTC). Raises UndeliveredError or RefusedError."""


def make_senders(section: NotifySection, secrets: NotifySecrets) -> dict[str, Sender]:
    """The way to each recipient by name. Raises OSError (ssl.SSLError too) for an authority that cannot be read."""
    senders: dict[str, Sender] = {}
    for row in section.to:
        if row.email is not None and section.smtp is not None:
            smtp = section.smtp
            trusted = ssl.create_default_context(cafile=None if smtp.ca is None else str(smtp.ca))
            senders[row.name] = partial(_mail, row, smtp, secrets.smtp_password, trusted)
        else:
            address = secrets.webhooks[row.name] if row.webhook == FROM_SECRETS else str(row.webhook)
            senders[row.name] = partial(_post, row, address, secrets.tokens.get(row.name, ""))
    return senders


def _mail(
    row: RecipientRow,
    smtp: SmtpSection,
    password: str,
    trusted: ssl.SSLContext,
    messages: Sequence[AlarmMessage],
    now: float,
) -> None:
    mail = EmailMessage()
    mail["From"], mail["To"], mail["Subject"] = smtp.sender, row.email, subject_of(messages)
    mail["Date"] = formatdate(now)
    mail["Message-ID"] = f"<{identity(messages, row.name)}@decanter.invalid>"
    mail["Auto-Submitted"] = "auto-generated"  # RFC 3834: nobody's holiday answers it
    mail.set_content(text_of(messages, escalated_after=row.after))
    try:
        if smtp.security == "tls":
            server: smtplib.SMTP = smtplib.SMTP_SSL(smtp.host, smtp.port, timeout=TIMEOUT, context=trusted)
        else:
            server = smtplib.SMTP(smtp.host, smtp.port, timeout=TIMEOUT)
        with server:
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
        raise UndeliveredError(f"the mail server cannot be used ({_reason(error)})") from None
    except ValueError:  # a name or an address that no header holds; of TLS it would be an OSError too
        raise RefusedError("it cannot be written as a mail") from None


def _refusal(code: int, sentence: str) -> Exception:
    """SMTP's 5xx are for good, its 4xx for now (RFC 5321, 4.2.1)."""
    return RefusedError(sentence) if code >= 500 else UndeliveredError(sentence)


def _post(row: RecipientRow, address: str, token: str, messages: Sequence[AlarmMessage], _: float) -> None:
    parts = urlsplit(address)
    host, path = str(parts.hostname), (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    if parts.scheme == "https":
        line: HTTPConnection = HTTPSConnection(host, parts.port, timeout=TIMEOUT, context=ssl.create_default_context())
    else:
        line = HTTPConnection(host, parts.port, timeout=TIMEOUT)
    plain = plain_of(messages, recipient=row.name, escalated_after=row.after)
    headers: Mapping[str, str] = {"Content-Type": "application/json", "Idempotency-Key": str(plain["id"])}
    headers = {**headers, **({"Authorization": f"Bearer {token}"} if token else {})}
    try:
        line.request("POST", path, body=json.dumps(plain).encode(), headers=headers)
        status = line.getresponse().status
    except (OSError, HTTPException) as error:
        raise UndeliveredError(f"the web hook cannot be reached ({_reason(error)})") from None
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


def _reason(error: Exception) -> str:
    """What an error says without quoting what was sent or asked for."""
    if isinstance(error, TimeoutError):
        return "no answer in time"
    if isinstance(error, ssl.SSLError):
        return f"TLS: {error.reason or 'failed'}"
    return (error.strerror if isinstance(error, OSError) else None) or type(error).__name__
