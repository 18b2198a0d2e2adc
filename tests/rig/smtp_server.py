"""A mail server in a process of its own: STARTTLS, a login, and messages as files. It prints its port.

Arguments: a folder for the messages, a folder with server.pem and server.key, a user, a password, and how many messages
it puts off (451) before it takes one. It does not take mail for addresses that begin with "nobody".
"""

import asyncio
import ssl
import sys
from pathlib import Path
from typing import Any

from aiosmtpd.smtp import SMTP, AuthResult, LoginPassword


class Mailroom:
    """What the server does with a message."""

    def __init__(self, folder: Path, put_off: int) -> None:
        self.folder, self.put_off, self.count = folder, put_off, 0

    async def handle_RCPT(self, _server: Any, _session: Any, envelope: Any, address: str, _options: Any) -> str:  # noqa: N802
        if address.startswith("nobody"):
            return "550 no such mailbox"
        envelope.rcpt_tos.append(address)
        return "250 OK"

    async def handle_DATA(self, _server: Any, _session: Any, envelope: Any) -> str:  # noqa: N802
        if self.put_off > 0:
            self.put_off -= 1
            return "451 later"
        self.count += 1
        draft = self.folder / f".{self.count}"
        draft.write_bytes(envelope.content)
        draft.rename(self.folder / f"{self.count}.eml")
        return "250 OK"


async def main(folder: Path, certificates: Path, user: str, password: str, put_off: int) -> None:
    """Serve until it is killed."""

    def authenticate(_server: Any, _session: Any, _envelope: Any, _mechanism: str, given: Any) -> AuthResult:
        right = isinstance(given, LoginPassword) and (given.login, given.password) == (user.encode(), password.encode())
        return AuthResult(success=right, handled=right)

    tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    tls.load_cert_chain(certificates / "server.pem", certificates / "server.key")
    room = Mailroom(folder, put_off)

    def protocol() -> SMTP:
        return SMTP(room, tls_context=tls, require_starttls=True, authenticator=authenticate, auth_required=True)

    server = await asyncio.get_running_loop().create_server(protocol, "127.0.0.1", 0)
    print(server.sockets[0].getsockname()[1], flush=True)
    await server.serve_forever()


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3], sys.argv[4], int(sys.argv[5])))
