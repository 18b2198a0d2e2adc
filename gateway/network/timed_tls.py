"""Encrypted connections, and HTTP over them, whose waits end at one deadline in all (`timed_socket`)."""

import socket
import ssl
from http.client import HTTP_PORT, HTTPS_PORT, HTTPConnection
from math import inf
from pathlib import Path
from time import monotonic
from typing import Any

from gateway.network.timed_socket import TimedSocket, connect

_NO_TLS = frozenset({"WRONG_VERSION_NUMBER", "PACKET_LENGTH_TOO_LONG", "RECORD_LAYER_FAILURE"})
"""OpenSSL's reasons where the peer's first bytes are another protocol's."""


class TimedTlsSocket(TimedSocket, ssl.SSLSocket):
    """An encrypted connection with a deadline."""

    def do_handshake(self, block: bool = False) -> None:
        """As an encrypted socket's, within the time; one that fails is closed."""
        try:
            self.limit()
            super().do_handshake(block)
        except (OSError, ValueError):
            self.close()
            raise


class TimedTls(ssl.SSLContext):
    """Encrypts connections with a deadline, which they keep."""

    sslsocket_class = TimedTlsSocket

    def wrap_socket(self, sock: socket.socket, *given: Any, **keys: Any) -> ssl.SSLSocket:
        """As a context's, within the time of the socket."""
        if isinstance(sock, TimedSocket):
            sock.limit()  # the handshake has its time-out, as a whole
        wrapped = super().wrap_socket(sock, *given, **keys)
        if isinstance(sock, TimedSocket) and isinstance(wrapped, TimedTlsSocket):
            wrapped.end, wrapped.room = sock.end, sock.room
        return wrapped


def make_tls(ca: Path | None) -> TimedTls:
    """Trusts an authority, the system's without one, and checks names, as `ssl.create_default_context` does.

    Raises OSError (ssl.SSLError too) for an authority that cannot be read.
    """
    context = TimedTls(ssl.PROTOCOL_TLS_CLIENT)
    if ca is None:
        context.load_default_certs()
    else:
        context.load_verify_locations(ca)
    return context


def failure_reason(error: Exception) -> str:
    """Why a connection has failed, without a word of what was sent: of TLS, what is wrong with whose certificate."""
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"TLS: {error.reason} (certificate verify failed: {error.verify_message.rstrip('.')})"
    if isinstance(error, ssl.SSLError):
        return f"TLS: {error.reason or 'failed'}" + (" (it speaks another protocol there)" * (error.reason in _NO_TLS))
    if isinstance(error, TimeoutError):
        return "no answer in time"
    return (error.strerror if isinstance(error, OSError) else None) or type(error).__name__


class TimedHttp(HTTPConnection):
    """HTTP to a server, encrypted with a context; `allow` begins what has a deadline of its own."""

    def __init__(self, host: str, port: int | None, tls: TimedTls | None) -> None:
        self.default_port = HTTP_PORT if tls is None else HTTPS_PORT
        super().__init__(host, port)
        self._tls, self._end, self._room = tls, inf, inf

    def allow(self, seconds: float, room: float) -> None:
        """Let all that is done from now on take so long, and the answers be so large (bytes), in all."""
        self._end, self._room = monotonic() + seconds, room
        if isinstance(self.sock, TimedSocket):
            self.sock.end, self.sock.room = self._end, room

    def connect(self) -> None:
        """Connect within the time. Raises OSError."""
        line = connect(self.host, self.port, self._end)
        line.room = self._room
        self.sock = line if self._tls is None else self._tls.wrap_socket(line, server_hostname=self.host)
