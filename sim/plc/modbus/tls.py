"""The face of Modbus/TCP Security: TLS with certificates on both sides, and rights by the role in the client's.

MODBUS/TCP Security Protocol Specification v21: the Modbus TCP frame, header included, inside TLS 1.2 or later; the role
is a UTF8String in the certificate's extension 1.3.6.1.4.1.50316.802.1; what a role may not do is answered with
exception 1; a certificate without a role may do nothing.
"""

import ssl
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from cryptography import x509

from sim.plc.modbus.server import ModbusServer, Security
from sim.plc.modbus.units import ServedProgram
from sim.plc.program import ILLEGAL_FUNCTION, InputError

ROLE = x509.ObjectIdentifier("1.3.6.1.4.1.50316.802.1")
DEFAULT_ROLES = ("Gateway=write", "Viewer=read")
_RIGHTS = ("read", "write")
_READING = frozenset({1, 2, 3, 4, 43})
_UTF8_STRING = 0x0C


def make(plc: ServedProgram, options: Mapping[str, Any], complain: Callable[[str], None]) -> ModbusServer:
    """The secured face. Raises InputError for certificates that cannot be used and roles that make no sense."""
    roles = parse_roles(options["tls_role"] or DEFAULT_ROLES)
    security = Security(server_context(options["tls"]), lambda peer: _rights(peer, roles))
    place = (options["host"], options["tls_port"], options["max_clients"])
    return ModbusServer(plc, *place, complain, name="tls", security=security)


def server_context(folder: Path) -> ssl.SSLContext:
    """TLS 1.2 or later with `server.pem`, `server.key` and `ca.pem` of the folder. Raises InputError."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.verify_mode = ssl.CERT_REQUIRED
    for name in ("server.pem", "server.key", "ca.pem"):
        if not (folder / name).is_file():
            raise InputError(f"--tls: {folder}: there is no {name}; make all with `decanter certificates {folder}`")
    try:
        context.load_cert_chain(folder / "server.pem", folder / "server.key")
        context.load_verify_locations(folder / "ca.pem")
    except (ssl.SSLError, OSError) as error:
        raise InputError(f"--tls: {folder}: cannot be used ({error.strerror or error}); make them anew") from None
    return context


def parse_roles(texts: tuple[str, ...]) -> dict[str, str]:
    """`("Gateway=write", "Viewer=read")` as a table. Raises InputError."""
    roles = {}
    for text in texts:
        role, _, right = text.partition("=")
        if not role or right not in _RIGHTS:
            raise InputError(f"--tls-role: {text!r} cannot be read; give ROLE=read or ROLE=write")
        roles[role] = right
    return roles


_CERTIFICATE_ERRORS = (
    x509.InvalidVersion,
    x509.ExtensionNotFound,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
    ValueError,
)
"""What the library raises of a certificate that cannot be read; it has no common base of its own."""


def certificate_role(certificate: bytes | None) -> str:
    """The role in a certificate (DER); empty where there is none."""
    if certificate is None:
        return ""
    try:
        extension = x509.load_der_x509_certificate(certificate).extensions.get_extension_for_oid(ROLE)
    except _CERTIFICATE_ERRORS:
        return ""
    value = extension.value
    data = value.value if isinstance(value, x509.UnrecognizedExtension) else b""
    # A UTF8String of at most 127 bytes: tag, length, text.
    if len(data) < 2 or data[0] != _UTF8_STRING or data[1] != len(data) - 2:
        return ""
    return data[2:].decode(errors="replace")


def _rights(certificate: bytes | None, roles: Mapping[str, str]) -> tuple[str, Callable[[int], int | None]]:
    role = certificate_role(certificate)
    right = roles.get(role, "")

    def refuses(function: int) -> int | None:
        allowed = right == "write" or (right == "read" and function in _READING)
        return None if allowed else ILLEGAL_FUNCTION

    return role, refuses
