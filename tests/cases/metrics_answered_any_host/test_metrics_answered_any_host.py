"""`/metrics` answered whatever name it was asked by, so that a web page could read it by a name that leads here."""

from asyncio import to_thread as in_thread
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from http.client import HTTPConnection

import pytest

from drivers.supervision import Supervisor
from gateway.outside.northbound.metrics_server import MetricsServer
from gateway.settings import MetricsSection
from tests.rig.servers import until


def status_of(port: int, host: str | None) -> int:
    line = HTTPConnection("127.0.0.1", port, timeout=60.0)
    try:
        line.putrequest("GET", "/metrics", skip_host=True)
        if host is not None:
            line.putheader("Host", host)
        line.endheaders()
        return line.getresponse().status
    finally:
        line.close()


@asynccontextmanager
async def serving(**keys: object) -> AsyncIterator[MetricsServer]:
    server = MetricsServer(MetricsSection.model_validate({"port": 0, **keys}), dict, [])
    thread = Supervisor().thread("metrics", server.run, stop=server.stop)
    try:
        await in_thread(lambda: until(lambda: server._server is not None and server._server.started))
        yield server
    finally:
        server.close()
        await in_thread(lambda: thread.join(60.0))


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:{}", 200),
        ("localhost:{}", 200),
        ("LOCALHOST", 200),
        ("[::1]:{}", 200),
        ("192.168.7.5:{}", 200),
        ("box.plant.local:{}", 200),
        ("evil.example:{}", 421),
        ("box.plant.local.evil.example", 421),
        ("127.0.0.1.evil.example:{}", 421),
        ("localhost.evil.example", 421),
        ("[::1", 421),
        ("", 421),
    ],
)
async def test_only_its_own_names_are_answered(host: str, status: int) -> None:
    async with serving(names=["Box.plant.local"]) as server:
        assert await in_thread(lambda: status_of(server.port, host.format(server.port))) == status
