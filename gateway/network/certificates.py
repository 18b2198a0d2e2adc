"""Certificates for Modbus/TCP Security and for OPC UA, for commissioning and tests.

For Modbus/TCP Security: one authority, a server, clients with roles.

For a plant with a public key infrastructure of its own these are not needed: its certificates do, with the role in
the client's. Keys are elliptic (P-256), signatures ECDSA with SHA-256.

OPC UA's policy Basic256Sha256 wants RSA: an application's certificate signs itself and names the application, and each
side is given the other's.
"""

import datetime as dt
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from ipaddress import ip_address
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec, rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from drivers.named_files import name_write_errors
from gateway.network.key_pair import NOT_A_KEY, key_problem

ROLE = x509.ObjectIdentifier("1.3.6.1.4.1.50316.802.1")
"""The extension that holds a client's role as a UTF8String (MODBUS/TCP Security v21)."""

OPC_UA_CERTIFICATE, OPC_UA_KEY, OPC_UA_TRUSTED = "opcua.pem", "opcua.key", "trusted"
"""The files of an OPC UA application in its folder, and the folder of the certificates that it trusts."""
_RSA_BITS = 2048

_NOT_A_CERTIFICATE = (
    *NOT_A_KEY,
    x509.InvalidVersion,
    x509.ExtensionNotFound,
    x509.DuplicateExtension,
    x509.UnsupportedGeneralNameType,
)
LONGEST_ROLE = 64
_UTF8_STRING = 0x0C
_CLOCK_SLACK = dt.timedelta(hours=1)
"""How far the PLC's clock may be behind without refusing a certificate made just now."""


@dataclass(frozen=True, slots=True)
class Signer:
    """Who signs: the certificate and the key of the authority."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey | rsa.RSAPrivateKey


def make_all(
    folder: Path, *, hosts: Sequence[str], role: str = "Gateway", days: int = 825, now: dt.datetime | None = None
) -> Path:
    """Write ca.pem, ca.key, server.pem, server.key, client.pem and client.key into `folder`; gives the folder.

    `hosts` are the names and addresses by which clients call the server, `role` is the client's. Keys are readable by
    their owner alone. Raises ValueError for a role or host that cannot be, FileExistsError rather than replace an
    authority that is there, OSError where it cannot be written.
    """
    now = now or dt.datetime.now(dt.UTC)
    if (folder / "ca.key").exists():
        raise FileExistsError(f"{folder}: there is an authority already; give another folder, or remove it")
    authority = make_authority(now, days)
    server = issue(authority, "decanter PLC", now, days, hosts=hosts)
    client = issue(authority, "decanter gateway", now, days, role=role)
    folder.mkdir(parents=True, exist_ok=True)
    for name, signer in (("ca", authority), ("server", server), ("client", client)):
        write(folder, name, signer)
    return folder


def make_application(folder: Path, *, hosts: Sequence[str], days: int = 825, now: dt.datetime | None = None) -> Path:
    """Write opcua.pem and opcua.key of an OPC UA application into `folder`, and make `trusted` in it; gives the folder.

    The application's URI is urn:HOST:decanter-gateway, by the first of `hosts`. Raises as `make_all` does.
    """
    now = now or dt.datetime.now(dt.UTC)
    if (folder / OPC_UA_KEY).exists():
        raise FileExistsError(f"{folder / OPC_UA_KEY}: is there already; give another folder, or remove it")
    names = [_host(host) for host in hosts]
    uri = x509.UniformResourceIdentifier(f"urn:{hosts[0]}:decanter-gateway")
    key = rsa.generate_private_key(public_exponent=65_537, key_size=_RSA_BITS)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "decanter gateway")])
    use = x509.KeyUsage(
        digital_signature=True,
        content_commitment=True,
        key_encipherment=True,
        data_encipherment=True,
        key_agreement=False,
        # It signs itself, and is its own authority to those who check chains.
        key_cert_sign=True,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    certificate = (
        x509.CertificateBuilder(
            issuer_name=name,
            subject_name=name,
            public_key=key.public_key(),
            serial_number=x509.random_serial_number(),
            not_valid_before=now - _CLOCK_SLACK,
            not_valid_after=now + dt.timedelta(days=days),
        )
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(use, critical=True)
        .add_extension(
            x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]), critical=False
        )
        .add_extension(x509.SubjectAlternativeName([uri, *names]), critical=False)
        .add_extension(identifier, critical=False)
        .sign(key, hashes.SHA256())
    )
    (folder / OPC_UA_TRUSTED).mkdir(parents=True, exist_ok=True)
    write(folder, "opcua", Signer(certificate, key))
    return folder


def application_problem(folder: Path) -> str | None:
    """What is wrong with the files of an OPC UA application, in a sentence; None if nothing is."""
    advice = f"`decanter certificates {folder} --opcua --host NAME` makes them"
    try:
        certificate = x509.load_pem_x509_certificate((folder / OPC_UA_CERTIFICATE).read_bytes())
        key = serialization.load_pem_private_key((folder / OPC_UA_KEY).read_bytes(), None)
        names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        is_pair = isinstance(key, rsa.RSAPrivateKey) and key.public_key() == certificate.public_key()
    except OSError as error:
        return f"{error.filename}: cannot be read ({(error.strerror or str(error)).lower()}); {advice}"
    except _NOT_A_CERTIFICATE:
        return f"{folder}: {OPC_UA_CERTIFICATE} and {OPC_UA_KEY} are no certificate and its key; {advice}"
    if not is_pair:
        return f"{folder / OPC_UA_KEY}: is not the RSA key of {OPC_UA_CERTIFICATE}; {advice}"
    if not names.get_values_for_type(x509.UniformResourceIdentifier):
        return f"{folder / OPC_UA_CERTIFICATE}: names no application (a URI among its alternative names); {advice}"
    return key_problem(folder / OPC_UA_KEY)


def trusted_certificates(folder: Path) -> Iterator[bytes]:
    """The certificates (DER) of the applications that the one in `folder` trusts, as they are by now.

    A file that holds none trusts nobody.
    """
    for path in sorted((folder / OPC_UA_TRUSTED).glob("*")):
        with suppress(OSError, *_NOT_A_CERTIFICATE):
            content = path.read_bytes()
            if content.startswith(b"-----"):
                certificate = x509.load_pem_x509_certificate(content)
            else:
                certificate = x509.load_der_x509_certificate(content)
            yield certificate.public_bytes(serialization.Encoding.DER)


def make_authority(now: dt.datetime, days: int, name: str = "decanter commissioning authority") -> Signer:
    """A new authority that signs its own certificate."""
    key = ec.generate_private_key(ec.SECP256R1())
    builder = _builder(name, name, key, now, days)
    builder = builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
    builder = builder.add_extension(_key_usage(signs=True), critical=True)
    identifier = x509.SubjectKeyIdentifier.from_public_key(key.public_key())
    return Signer(builder.add_extension(identifier, critical=False).sign(key, hashes.SHA256()), key)


def issue(
    authority: Signer, name: str, now: dt.datetime, days: int, *, hosts: Sequence[str] = (), role: str = ""
) -> Signer:
    """A certificate of the authority: a server's with `hosts`, or a client's, with `role` unless that is empty."""
    if len(role.encode()) > LONGEST_ROLE:
        raise ValueError(f"the role {role!r} is longer than {LONGEST_ROLE} bytes; give a shorter one")
    key = ec.generate_private_key(ec.SECP256R1())
    issuer = authority.certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value
    builder = _builder(name, str(issuer), key, now, days)
    builder = builder.add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
    builder = builder.add_extension(_key_usage(signs=False), critical=True)
    use = ExtendedKeyUsageOID.SERVER_AUTH if hosts else ExtendedKeyUsageOID.CLIENT_AUTH
    builder = builder.add_extension(x509.ExtendedKeyUsage([use]), critical=False)
    public = authority.key.public_key()
    builder = builder.add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(public), critical=False)
    if hosts:
        builder = builder.add_extension(x509.SubjectAlternativeName([_host(host) for host in hosts]), critical=False)
    if role:
        text = role.encode()
        value = bytes((_UTF8_STRING, len(text))) + text
        builder = builder.add_extension(x509.UnrecognizedExtension(ROLE, value), critical=False)
    return Signer(builder.sign(authority.key, hashes.SHA256()), key)


def write(folder: Path, name: str, signer: Signer) -> None:
    """NAME.pem, and NAME.key for its owner's eyes only."""
    with name_write_errors(folder / f"{name}.pem"):
        (folder / f"{name}.pem").write_bytes(signer.certificate.public_bytes(serialization.Encoding.PEM))
    key = folder / f"{name}.key"
    key.touch(mode=0o600)
    key.chmod(0o600)
    encoding, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    with name_write_errors(key):
        key.write_bytes(signer.key.private_bytes(encoding, form, serialization.NoEncryption()))


def _builder(
    name: str, issuer: str, key: ec.EllipticCurvePrivateKey, now: dt.datetime, days: int
) -> x509.CertificateBuilder:
    return x509.CertificateBuilder(
        issuer_name=x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, issuer)]),
        subject_name=x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)]),
        public_key=key.public_key(),
        serial_number=x509.random_serial_number(),
        not_valid_before=now - _CLOCK_SLACK,
        not_valid_after=now + dt.timedelta(days=days),
    )


def _key_usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs,
        crl_sign=signs,
        encipher_only=False,
        decipher_only=False,
    )


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ip_address(host))
    except ValueError:
        if not host.isascii() or not host or " " in host:
            raise ValueError(f"the host {host!r} is neither a name nor an address") from None
        return x509.DNSName(host)


def remaining_days(folder: Path, now: float) -> list[float]:
    """The days (from `now`, s UTC) for which the certificates in a folder are still valid, below 0 where they are not.

    What cannot be read is left out: the link says that it cannot be used.
    """
    found = []
    for path in sorted(folder.glob("*.pem")):
        with suppress(OSError, ValueError):
            for certificate in x509.load_pem_x509_certificates(path.read_bytes()):
                found.append((certificate.not_valid_after_utc.timestamp() - now) / 86_400.0)
    return found
