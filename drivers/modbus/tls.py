"""Modbus/TCP Security, the client's side: the TLS context, and every failure of it in a sentence of its own.

MODBUS/TCP Security Protocol Specification v21: the Modbus TCP frame, header included, inside TLS 1.2 or later, with
certificates on both sides; the client's holds its role as a UTF8String in extension 1.3.6.1.4.1.50316.802.1.
"""

import datetime as dt
import ssl
import stat
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509

from drivers.errors import DriverError

PORT = 802
ROLE = x509.ObjectIdentifier("1.3.6.1.4.1.50316.802.1")
FILES = ("ca.pem", "client.pem", "client.key")
EXPIRES_SOON = dt.timedelta(days=30)

# OpenSSL's X509_V_ERR_...: what is wrong with the server's certificate.
_OF_SERVER = {
    9: "the PLC's certificate is not valid yet: compare the clocks of both",
    10: "the PLC's certificate has expired: have a new one made",
    18: "the PLC's certificate is signed by itself and not by the authority in ca.pem",
    19: "the PLC's certificate is not from the authority in ca.pem: give the one that signed it",
    20: "the PLC's certificate is not from the authority in ca.pem: give the one that signed it",
    21: "the PLC's certificate is not from the authority in ca.pem: give the one that signed it",
    62: "the PLC's certificate is for another name: call the PLC by the name in it, or give it as tls_name",
    64: "the PLC's certificate is for another address: call the PLC by the name in it, or give it as tls_name",
}
# OpenSSL's reasons: what the server said to us, or how the handshake broke.
_OF_HANDSHAKE = {
    "CERTIFICATE_REQUIRED": "the PLC demands a client certificate and got none",
    "ALERT_CERTIFICATE_REQUIRED": "the PLC demands a client certificate and got none",
    "UNKNOWN_CA": "the PLC does not know the authority of our certificate (client.pem): have it installed there",
    "CERTIFICATE_EXPIRED": "the PLC refuses our certificate (client.pem): it has expired, have a new one made",
    "CERTIFICATE_UNKNOWN": "the PLC refuses our certificate (client.pem) without saying why",
    "BAD_CERTIFICATE": "the PLC refuses our certificate (client.pem) as bad",
    "UNSUPPORTED_CERTIFICATE": "the PLC refuses our certificate (client.pem): it is not one for clients",
    "ACCESS_DENIED": "the PLC knows our certificate (client.pem) and denies access",
    "WRONG_VERSION_NUMBER": "what answers there speaks no TLS: is it plain Modbus TCP (port 502)?",
    "RECORD_LAYER_FAILURE": "what answers there speaks no TLS: is it plain Modbus TCP (port 502)?",
    "PROTOCOL_VERSION": "the PLC has no TLS 1.2 or later, and less is not safe",
    "UNSUPPORTED_PROTOCOL": "the PLC has no TLS 1.2 or later, and less is not safe",
    "HANDSHAKE_FAILURE": "the PLC and this gateway have no method of encryption in common",
}


@dataclass(frozen=True, slots=True)
class Identity:
    """What this client shows: the TLS context, the role in its certificate ("" for none) and until when it is valid."""

    folder: Path
    context: ssl.SSLContext
    role: str
    expires: dt.datetime


_UNREADABLE = (
    x509.InvalidVersion,
    x509.ExtensionNotFound,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
    ValueError,
)
"""What the library raises of a certificate that cannot be read; it has no common base of its own."""


def load_identity(folder: Path) -> Identity:
    """The client's identity in `folder` (ca.pem, client.pem, client.key). Raises DriverError in one sentence."""
    missing = [name for name in FILES if not (folder / name).is_file()]
    if missing:
        raise DriverError(f"modbus: certificates: {folder} has no {missing[0]}; it needs {', '.join(FILES)}")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        context.load_verify_locations(folder / "ca.pem")
        # An empty password: a key that has one fails here instead of asking on the terminal.
        context.load_cert_chain(folder / "client.pem", folder / "client.key", password="")
        certificate = x509.load_pem_x509_certificate((folder / "client.pem").read_bytes())
    except (OSError, *_UNREADABLE) as error:
        reason = getattr(error, "reason", None) or getattr(error, "strerror", None) or str(error)
        raise DriverError(f"modbus: certificates: {folder} cannot be used ({reason}); make them anew") from None
    return Identity(folder, context, certificate_role(certificate), certificate.not_valid_after_utc)


def certificate_role(certificate: x509.Certificate) -> str:
    """The role in a certificate; empty where there is none."""
    try:
        value = certificate.extensions.get_extension_for_oid(ROLE).value
    except _UNREADABLE:
        return ""
    text = value.value if isinstance(value, x509.UnrecognizedExtension) else b""
    return text[2:].decode(errors="replace")  # a short UTF8String: tag, length, text


def refusal_hint(role: str) -> str:
    """Why the PLC may refuse what it knows, by the role in the certificate that it is shown ("" for none)."""
    return f"or {f'the role {role!r} of' if role else 'the lack of a role in'} our certificate does not allow it"


def cautions(folder: Path, now: dt.datetime) -> tuple[str, ...]:
    """What works today and should not stay so: a key that others may read, a certificate about to expire, no role.

    Where the files cannot be used, that they cannot.
    """
    cautions = []
    try:
        identity = load_identity(folder)
        mode = stat.S_IMODE((folder / "client.key").stat().st_mode)
    except (DriverError, OSError) as error:
        return (str(error),)
    if mode & 0o077:
        cautions.append(f"{identity.folder / 'client.key'} can be read by others (mode {mode:o}): chmod 600 it")
    left = identity.expires - now
    if left < EXPIRES_SOON:
        state = "has expired" if left < dt.timedelta(0) else f"expires in {left.days} days"
        cautions.append(f"{identity.folder / 'client.pem'} {state} ({identity.expires:%Y-%m-%d}): have a new one made")
    if not identity.role:
        cautions.append(f"{identity.folder / 'client.pem'} has no role: the PLC may refuse every request")
    return tuple(cautions)


def sentence(error: Exception) -> str:
    """What a failure of TLS means for the one who commissions it."""
    if isinstance(error, ssl.SSLCertVerificationError):
        sentence = _OF_SERVER.get(error.verify_code)
        return sentence or f"the PLC's certificate is not accepted: {error.verify_message}"
    if isinstance(error, ssl.SSLError):
        reason = (error.reason or "").upper()
        sentence = next((text for key, text in _OF_HANDSHAKE.items() if reason.endswith(key)), None)
        return sentence or f"TLS failed: {error.reason or error}"
    if isinstance(error, ConnectionResetError | ConnectionAbortedError | EOFError):
        return "the peer broke the connection off in the TLS handshake: is Modbus/TCP Security served there?"
    return (error.strerror if isinstance(error, OSError) else None) or str(error)
