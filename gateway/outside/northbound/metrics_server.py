"""The server of `[northbound.metrics]`: uvicorn in a thread of its own, which asks the gateway's loop how all is."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Sequence
from contextlib import suppress
from ipaddress import ip_address
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import uvicorn
from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.exposition import choose_encoder
from starlette.applications import Starlette
from starlette.responses import Response
from starlette.routing import Route

from gateway.network import SharingListener
from gateway.outside.northbound.metrics import FeedFigures, GatewayCollector
from gateway.outside.northbound.pictures import Pictures, ask_statuses
from gateway.settings import MetricsSection

if TYPE_CHECKING:
    from starlette.requests import Request

MOST_REQUESTS = 8
"""Connections at a time; an address that has more of them gives way to another."""


class MetricsServer:
    """Serves `/metrics` from `run`, in a thread, until `close`. `port` is the one that is listened at."""

    def __init__(self, section: MetricsSection, pictures: Pictures, feeds: Sequence[FeedFigures]) -> None:
        self._section, self._pictures, self._feeds = section, pictures, feeds
        self._gateway_loop = asyncio.get_running_loop()
        self._server: uvicorn.Server | None = None
        self.port = section.port or 0
        self.stop = threading.Event()

    def _is_own_host(self, host: str) -> bool:
        """Whether a request's Host is this server: another site's name that leads here is that site's trick."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        try:
            ip_address(name)
        except ValueError:
            return name in {each.lower() for each in ("localhost", self._section.host, *self._section.names)}
        return True  # no name, and so nobody's to lead here

    async def _metrics(self, request: Request) -> Response:
        if not self._is_own_host(request.headers.get("host", "")):
            said = "this name is not among [northbound.metrics] names\n"
            return Response(said, status_code=421, media_type="text/plain")
        try:
            statuses = await ask_statuses(self._pictures, self._gateway_loop)
        except (TimeoutError, RuntimeError):
            return Response("the gateway does not answer\n", status_code=503, media_type="text/plain")
        registry = CollectorRegistry()
        registry.register(GatewayCollector(statuses, self._feeds))
        ProcessCollector(registry=registry)
        encode, media_type = choose_encoder(request.headers.get("accept", ""))
        return Response(encode(registry), headers={"Content-Type": media_type})

    def run(self) -> None:
        """Serve until `close`. Raises OSError, in one sentence, where the port cannot be had."""
        if self.stop.is_set():
            return
        section = self._section
        listener = SharingListener(socket.AF_INET, socket.SOCK_STREAM)
        listener.limit_connections(MOST_REQUESTS)
        try:
            listener.bind_address((section.host, self.port), MOST_REQUESTS)
        except OSError as error:
            listener.close()
            reason = error.strerror or str(error)
            raise OSError(
                error.errno, f"[northbound.metrics] cannot listen at {section.host}:{section.port}: {reason.lower()}"
            ) from None
        with listener:
            self.port = listener.getsockname()[1]
            config = uvicorn.Config(
                Starlette(routes=[Route("/metrics", self._metrics)]),
                loop="asyncio",
                http="h11",
                ws="none",
                lifespan="off",
                log_config=None,
                log_level="critical",
                access_log=False,
                proxy_headers=False,
                server_header=False,
                timeout_keep_alive=60,
                timeout_graceful_shutdown=1,
            )
            self._server = server = uvicorn.Server(config)
            # Signals are the gateway's: uvicorn's `run` would take them.
            asyncio.run(server.serve([listener]))

    def close(self) -> None:
        """End the server; its thread ends soon after."""
        self.stop.set()
        server = self._server
        if server is not None:
            with suppress(RuntimeError):
                server.should_exit = True
