"""Certificates for the tests of TLS, made once a session: keys and signatures cost, and nothing here changes them."""

import datetime as dt
import ssl
from functools import cache
from pathlib import Path

from gateway.network.certificates import Signer, issue, make_authority, write

NOW = dt.datetime.now(dt.UTC)
HOSTS = ("localhost", "127.0.0.1")
PLANT = "the plant's"


@cache
def authority(name: str) -> Signer:
    return make_authority(NOW - dt.timedelta(days=400), 800, name)


@cache
def server(name: str = PLANT, hosts: tuple[str, ...] = HOSTS, *, expired: bool = False) -> Signer:
    begin = NOW - dt.timedelta(days=300) if expired else NOW
    return issue(authority(name), "PLC", begin, 100, hosts=hosts)


@cache
def client(name: str = PLANT, role: str = "Gateway", *, expired: bool = False) -> Signer:
    begin = NOW - dt.timedelta(days=300) if expired else NOW
    return issue(authority(name), "gateway", begin, 100, role=role)


def folder(path: Path, *, ca: Signer | None = None, of_client: Signer | None = None) -> Path:
    """A gateway's certificates in `path`: the plant's own unless others are given."""
    path.mkdir(exist_ok=True)
    write(path, "ca", ca or authority(PLANT))
    write(path, "client", of_client or client())
    return path


def server_context(path: Path, *, of_server: Signer | None = None, ca: Signer | None = None) -> ssl.SSLContext:
    """A server that demands certificates of the plant's authority."""
    path.mkdir(exist_ok=True)
    write(path, "server", of_server or server())
    write(path, "trusted", ca or authority(PLANT))
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.verify_mode = ssl.CERT_REQUIRED
    context.load_cert_chain(path / "server.pem", path / "server.key")
    context.load_verify_locations(path / "trusted.pem")
    return context


def for_plc(path: Path) -> Path:
    """What the software PLC wants in its folder, beside a gateway's certificates."""
    folder(path)
    write(path, "server", server())
    return path
