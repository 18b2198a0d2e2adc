"""A gateway with its page, in a thread of the test's process, on a device in memory; a client that keeps cookies."""

import asyncio
import http.client
import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gateway.outside.web
from drivers.tag import Quality, Value
from gateway.machine.reading import plant_clock
from gateway.outside.web.access import AccountRole, add_account
from gateway.plant.app import run
from gateway.settings import Config
from gateway.store import read
from tests.gateway.support import CURRENT, RUNNING, TEMPERATURE, Bench, config_in, logged, two_modes

PASSWORD = "correct horse battery"  # noqa: S105 - of this test's accounts
PERIOD = 0.2
PAGE = f"""[page]
enabled = true
port = 0
labels = {{ {TEMPERATURE} = "gearbox bearing" }}
[scan]
period = {PERIOD}
[writeback]
mode = "shadow"
[alarms]
limit = 47.0
off_delay = 0.0
deadband = 0.5
[forecast]
horizons = [60.0, 900.0]
period = 3.0
runs = 20
"""


@dataclass
class Served:
    """A gateway that runs; what its device reads is put from the test's thread."""

    config: Config
    bench: Bench
    port: int

    def put(self, name: str, value: Value | None) -> None:
        """What the device reads from now on; None: nothing good."""
        self.bench.soft.put(name, value, Quality.GOOD if value is not None else Quality.SENSOR_FAILURE)

    def audited(self) -> list[tuple[str, str, dict[str, Any]]]:
        """Kind, who and detail of the rows that people have made, as they are on the disk."""
        return [(row.entry.kind, row.entry.who, dict(row.entry.detail)) for row in read(self.config.audit)]


def page_views() -> tuple[str, ...]:
    """The names of the page's views, as its frame has them."""
    frame = (Path(gateway.outside.web.__file__).parent / "static/page.js").read_text(encoding="utf-8")
    found = re.search(r"const VIEWS = \{(.*?)\};", frame, re.DOTALL)
    assert found is not None
    return tuple(re.findall(r"(\w+): \w+,", found[1]))


def eventually(true: Callable[[], Any], seconds: float = 300.0) -> Any:
    """What is true in the end. Raises AssertionError where it is not within so many seconds."""
    until = time.monotonic() + seconds
    while not (found := true()):
        assert time.monotonic() < until, "it has not come true"
        time.sleep(0.02)
    return found


@contextmanager
def served(
    folder: Path, text: str = PAGE, accounts: dict[str, AccountRole] | None = None, **overrides: Any
) -> Iterator[Served]:
    """A gateway on a decanter that runs, with accounts whose password is PASSWORD; `overrides` as of `config_in`."""
    folder.mkdir(parents=True, exist_ok=True)
    config = config_in(folder, text, model=two_modes(), **overrides)
    for name, role in (accounts or {}).items():
        add_account(config.users, name, role, PASSWORD)
    clock = plant_clock(1.0)
    bench = Bench(config, clock)  # type: ignore[arg-type]
    for name, value in ((RUNNING, True), (CURRENT, 150.0), (TEMPERATURE, 45.0)):
        bench.soft.put(name, value)
    ready, failed = threading.Event(), list[BaseException]()
    loops: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]] = []

    async def main() -> None:
        stop = asyncio.Event()
        loops.append((asyncio.get_running_loop(), stop))
        ready.set()
        await run(config, clock=clock, driver=bench, stop=stop)

    def thread() -> None:
        try:
            asyncio.run(main())
        except BaseException as error:  # noqa: BLE001 - it is raised in the test's thread
            failed.append(error)
        finally:
            ready.set()

    worker = threading.Thread(target=thread, name="gateway")
    worker.start()
    ready.wait(60.0)
    try:

        def port() -> int:
            if failed:
                raise failed[0]
            lines = logged(folder) if (folder / "gateway.jsonl").exists() else []
            found = [line["address"] for line in lines if line["event"] == "the page is served"]
            return int(found[-1].rpartition(":")[2]) if found else 0

        yield Served(config, bench, eventually(port))
    finally:
        if loops and worker.is_alive():
            loop, stop = loops[0]
            loop.call_soon_threadsafe(stop.set)
        worker.join(120.0)
        assert not worker.is_alive()


@dataclass
class Client:
    """Asks the REST interface over a real socket; keeps its session as a browser does."""

    port: int
    cookie: str = ""
    token: str = ""
    headers: dict[str, str] = field(default_factory=dict)
    address: str = "127.0.0.1"

    def ask(self, method: str, path: str, given: Any = None, **headers: str) -> tuple[int, Any]:
        """The status and the JSON of an answer."""
        status, _, body = self.raw(method, path, given, **headers)
        return status, json.loads(body) if body else None

    def raw(self, method: str, path: str, given: Any = None, **headers: str) -> tuple[int, dict[str, str], bytes]:
        """The status, headers and body of an answer."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=120.0, source_address=(self.address, 0))
        body = given if isinstance(given, bytes) else None if given is None else json.dumps(given).encode()
        sent = {"content-type": "application/json", "cookie": self.cookie, "x-csrf-token": self.token, **self.headers}
        sent |= {name.replace("_", "-"): value for name, value in headers.items()}
        try:
            connection.request(method, path, body, {name: value for name, value in sent.items() if value})
            answer = connection.getresponse()
            body = answer.read()
            kept = {name.lower(): value for name, value in answer.getheaders()}
        finally:
            connection.close()
        if "set-cookie" in kept and "decanter_session" in kept["set-cookie"]:
            self.cookie = kept["set-cookie"].partition(";")[0]
        return answer.status, kept, body

    def log_in(self, name: str, password: str = PASSWORD) -> int:
        """The status of a log-in; what follows is this person's."""
        status, answered = self.ask("POST", "/api/session", {"name": name, "password": password})
        self.token = answered.get("token", "") or ""
        return status
