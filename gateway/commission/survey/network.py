"""The way to a host before anything is asked of it, and what listens on a port that speaks no Modbus."""

import asyncio
import socket
from contextlib import suppress

from drivers.errors import LinkDown, LinkFault

_PATIENCE_S = 1.0
_HTTP = b"GET / HTTP/1.0\r\n\r\n"
_LOOKS_LIKE: tuple[tuple[bytes, str], ...] = (
    (b"SSH-", "an SSH server"),
    (b"HTTP/", "a web server"),
    (b"<", "a web server"),
    (b"\x15\x03", "TLS (Modbus/TCP Security: give --set certificates=DIR)"),
    (b"\x16\x03", "TLS (Modbus/TCP Security: give --set certificates=DIR)"),
    (b"220", "a mail or FTP server"),
    (b"\xff\xfb", "a telnet server"),
    (b"\xff\xfd", "a telnet server"),
    (b"RFB ", "a VNC server"),
    (b"\x03\x00\x00", "an RDP or S7 server (port 102 is Siemens' own protocol)"),
    (b"ACK", "an OPC UA server (port 4840)"),
    (b"ERRF", "an OPC UA server (port 4840)"),
)


async def resolve_host(host: str) -> list[str]:
    """What the name resolves to. Raises OSError."""
    infos = await asyncio.get_running_loop().getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return list(dict.fromkeys(str(info[4][0]) for info in infos))


def local_end(address: str) -> str:
    """This machine's address on the way to another one. Raises OSError where there is no way.

    Connecting a datagram socket asks the routing table and sends nothing.
    """
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect((address, 9))
        return str(probe.getsockname()[0])


def connect_sentence(host: str, port: int, error: LinkDown) -> str:
    """Why a connection was not made, as an engineer can act on it."""
    if error.fault is LinkFault.REFUSED:
        return (
            f"{host} is there and refuses port {port}: nothing listens on it; check the port (Modbus TCP 502, TLS 802) "
            "and that the server is enabled. A device that serves one client may refuse a second one like this"
        )
    if error.fault is LinkFault.UNREACHABLE:
        return f"there is no way to {host}: check the address, the cable and this machine's network settings"
    if error.fault is LinkFault.SILENT:
        return (
            f"nobody answers at {host} port {port}: wrong address, device off or unplugged, or a firewall that drops "
            "what comes"
        )
    return str(error)


def guess_service(received: bytes) -> str:
    """What the first bytes from a port betray; "" where nothing is known."""
    return next((name for start, name in _LOOKS_LIKE if received.startswith(start)), "")


def not_modbus(port: int, received: bytes) -> str:
    """The sentence for a port that answers with something else."""
    seen = guess_service(received)
    shown = received[:24].decode("ascii", errors="replace") if received[:4].isascii() else received[:12].hex(" ")
    is_it = f"it looks like {seen}" if seen else f"it begins with {shown!r}"
    return f"port {port} is no Modbus port: what answers there is not Modbus TCP, {is_it}"


async def read_greeting(host: str, port: int) -> bytes:
    """What a port that is silent in Modbus says when it is asked as a web server; b"" if it stays silent.

    To be asked only of a port that has answered no Modbus request: a Modbus device drops it by its protocol id.
    """
    with suppress(OSError, TimeoutError):
        async with asyncio.timeout(_PATIENCE_S):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                writer.write(_HTTP)
                return await reader.read(64)
            finally:
                writer.close()
    return b""
