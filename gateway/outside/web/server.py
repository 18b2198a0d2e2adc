"""The page's server: uvicorn in a thread and a loop of its own, so that no browser ever delays a scan.

What crosses between the two loops: pictures of the machines, taken in the gateway's and shown in the page's, and the
commands of the control socket the other way (`gateway.outside.web.calls`).
"""

from __future__ import annotations

import asyncio
import socket
import ssl
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from drivers.settings import ConfigError
from gateway.network import SharingListener, load_pair
from gateway.outside.status import GatewayStatus
from gateway.outside.texts import all_words
from gateway.outside.web.access import Accounts, AccountsError, PasswordChecks, Sessions, read_accounts
from gateway.outside.web.application import make_application
from gateway.outside.web.backing_up import BackupMaker
from gateway.outside.web.calls import Answer, GatewayCalls
from gateway.outside.web.live import LiveStream
from gateway.outside.web.reader import HistorianReader
from gateway.outside.web.state import Mail, PageState
from gateway.settings import Config
from gateway.store import Audit

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

IDLE_S = 15.0
"""A client that has sent no whole request for so long, or takes nothing of its answer, is let go."""
LONGEST_HEAD = 16 * 1024
BACKLOG = 64
CERTIFICATE_LOOK_S = 10.0
"""Seconds between two looks at whether the page's certificate has been replaced."""
REFRESH_S, MIN_REFRESH_S = 1.0, 0.1
"""Pictures are taken after scans, at most each tenth of a second, and once a second without any: ages grow."""


class PageLoop(asyncio.SelectorEventLoop):
    """The page's loop: who does not finish the handshake of TLS in IDLE_S is let go too, not after a minute."""

    async def create_server(self, *given: Any, **keys: Any) -> Any:
        """As a loop's."""
        timed = {"ssl_handshake_timeout": IDLE_S} if keys.get("ssl") is not None else {}
        make: Any = super().create_server
        return await make(*given, **keys, **timed)


class BoundedProtocol(H11Protocol):
    """uvicorn's HTTP/1.1, whose connections are bounded in how long they may do nothing."""

    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """A further client."""
        super().connection_made(transport)
        raw: socket.socket | None = transport.get_extra_info("socket")
        if raw is not None:
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            # Whoever takes nothing of what is sent is let go by the kernel.
            raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * IDLE_S))
        self._arm()

    def connection_lost(self, exc: Exception | None) -> None:
        """The client has gone."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def on_response_complete(self) -> None:
        """One request is answered; the next one has as long as the first had."""
        super().on_response_complete()
        self._arm()

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self.loop.call_later(IDLE_S, self._expire)

    def _expire(self) -> None:
        if self.cycle is None or self.cycle.response_complete:
            self.transport.abort()


def check_page(config: Config) -> None:
    """Raises ConfigError where the page may not be served as it is configured: before anything runs."""
    section = config.page
    try:
        accounts = read_accounts(config.users)
    except AccountsError as error:
        raise ConfigError([str(error)]) from None
    if not accounts and not (section.loopback and section.open_reading):
        raise ConfigError(
            [
                f"{config.path}: page: nobody could use it, as there is no account in {config.users}; make one with "
                "`decanter user add NAME --role administrator`"
            ]
        )
    if section.certificates is not None:
        _tls(section.certificates, config)


def _tls(folder: Path, config: Config) -> ssl.SSLContext:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    try:
        load_pair(context, *_pair(folder))
    except OSError as error:
        raise ConfigError(
            [
                f"{config.path}: page.certificates: server.pem and server.key in {folder} cannot be used ({error}); "
                "`decanter certificates FOLDER --host NAME` makes such"
            ]
        ) from None
    return context


def _pair(folder: Path) -> tuple[Path, Path]:
    return folder / "server.pem", folder / "server.key"


def _stamps(folder: Path) -> list[tuple[int, int, int]]:
    """What changes with the files of a folder; fewer where one is not there at this moment."""
    found = list[tuple[int, int, int]]()
    for path in _pair(folder):
        with suppress(OSError):
            status = path.stat()
            found.append((status.st_ino, status.st_mtime_ns, status.st_size))
    return found


class PageServer:
    """Serves the page from `run`, in a thread, until `close`; `feed` runs in the gateway's loop beside it.

    `port` is the one that is listened at once it is served.
    """

    def __init__(
        self,
        configs: Sequence[Config],
        *,
        answer: Answer,
        audit: Audit,
        now: Callable[[], float],
        mail: Mail,
        log: FilteringBoundLogger,
    ) -> None:
        self._configs, self._config = configs, configs[0]
        self._answer, self._audit, self._now, self._mail, self._log = answer, audit, now, mail, log
        self.port = self._config.page.port
        self.stop = threading.Event()
        self._gateway_loop = asyncio.get_running_loop()
        self._scanned: set[str] = set()
        self._wake = asyncio.Event()
        # Both are the page's own: set and used in its loop, or handed over to it.
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: uvicorn.Server | None = None
        self._live: LiveStream | None = None

    # ---------------------------------------------------------------- in the gateway's loop

    def note_scan(self, machine: str) -> None:
        """A machine was scanned: whoever looks at it is shown so."""
        self._scanned.add(machine)
        self._wake.set()

    async def feed(self, machines: Callable[[], Mapping[str, Callable[[], GatewayStatus]]]) -> None:
        """Hand pictures over to the page until cancelled; `machines` gives those that there are, by name."""
        shown: dict[str, float] = {}
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(REFRESH_S):
                    await self._wake.wait()
            self._wake.clear()
            scanned, self._scanned = self._scanned, set()
            live, loop = self._live, self._loop
            if live is None or loop is None or not live.listeners:
                continue
            there, now = machines(), time.monotonic()
            due = [name for name in there if name in scanned or now - shown.get(name, -REFRESH_S) >= 0.9 * REFRESH_S]
            statuses = {name: there[name]() for name in due}
            shown = {name: now if name in statuses else at for name, at in {**shown, **dict.fromkeys(due, now)}.items()}
            with suppress(RuntimeError):  # the page's loop has ended, and its thread begins another
                loop.call_soon_threadsafe(live.take, statuses, tuple(there), time.time())
            await asyncio.sleep(MIN_REFRESH_S)

    def close(self) -> None:
        """End the server; its thread ends soon after."""
        self.stop.set()
        loop = self._loop
        if loop is not None:
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(self._end)

    # ---------------------------------------------------------------- in the page's thread

    def run(self) -> None:
        """Serve until `close`. Raises OSError, in one sentence, where the port cannot be had."""
        if not self.stop.is_set():
            with self._open_listener() as listener, asyncio.Runner(loop_factory=PageLoop) as runner:
                runner.run(self._serve(listener))

    def _report_failure(self, path: str, error: Exception) -> None:
        self._log.error("a request to the page has failed", path=path, reason=repr(error), exc_info=error)

    def _end(self) -> None:
        if self._live is not None:
            self._live.close()
        if self._server is not None:
            self._server.should_exit = True

    @contextmanager
    def _open_listener(self) -> Iterator[socket.socket]:
        page = self._config.page
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                page.host, page.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
            )[0]
            listener = SharingListener(family, kind, protocol)
        except OSError as error:
            raise OSError(error.errno, f"[page] cannot listen at {page.host}: {error.strerror or error}") from None
        with listener:
            try:
                listener.limit_connections(2 * page.most_clients + 20)
                listener.bind_address(address, BACKLOG)
            except OSError as error:
                reason = (error.strerror or str(error)).lower()
                raise OSError(
                    error.errno, f"{page.host}:{page.port} cannot be served: {reason}; give another port under [page]"
                ) from None
            yield listener

    async def _serve(self, listener: socket.socket) -> None:
        config, page = self._config, self._config.page
        words = all_words()
        accounts = Accounts(config.users)
        live: LiveStream = LiveStream(lambda language, status: state.show(language, status), page.most_clients)
        # An unchanged value is stored so often, and a scan may be late.
        gap = config.historian.max_interval + 10.0 * max(each.scan.period for each in self._configs)
        state = PageState(
            config=config,
            calls=GatewayCalls(self._answer, self._gateway_loop),
            live=live,
            reader=HistorianReader(config.historian.path, gap),
            words=words,
            accounts=accounts,
            passwords=PasswordChecks(),
            sessions=Sessions(accounts, 60.0 * page.session_minutes),
            audit=self._audit,
            now=self._now,
            mail=self._mail,
            backups=BackupMaker(config),
        )
        context = None if page.certificates is None else _tls(page.certificates, config)
        server = uvicorn.Server(
            uvicorn.Config(
                make_application(state, self._report_failure),
                loop="asyncio",
                http=BoundedProtocol,
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                # An address that a client states itself is no address for the records.
                proxy_headers=False,
                server_header=False,
                timeout_keep_alive=int(IDLE_S),
                timeout_graceful_shutdown=1,
                h11_max_incomplete_event_size=LONGEST_HEAD,
                ssl_context_factory=None if context is None else partial(_keep_context, context),
            )
        )
        self.port = listener.getsockname()[1]
        self._live, self._server, self._loop = live, server, asyncio.get_running_loop()
        if self.stop.is_set():
            return
        scheme = "http" if context is None else "https"
        self._log.info("the page is served", address=f"{scheme}://{page.host}:{self.port}")
        following = asyncio.create_task(self._follow_certificate(context))
        try:
            await server.serve(sockets=[listener])
        finally:
            following.cancel()
            await state.reader.close()

    async def _follow_certificate(self, context: ssl.SSLContext | None) -> None:
        """Show whoever connects the certificate that is there by now; a pair that is none changes nothing."""
        folder = self._config.page.certificates
        if context is None or folder is None:
            return
        seen = _stamps(folder)
        while True:
            await asyncio.sleep(CERTIFICATE_LOOK_S)
            now = _stamps(folder)
            if now == seen:
                continue
            seen = now
            try:
                _tls(folder, self._config)  # what fails takes from a context the pair that it had
                load_pair(context, *_pair(folder))
            except (ConfigError, OSError, ValueError) as error:
                self._log.warning("the page keeps its former certificate", reason=str(error))
            else:
                self._log.info("the page has a new certificate", folder=str(folder))


def _keep_context(context: ssl.SSLContext, *_: object) -> ssl.SSLContext:
    return context
