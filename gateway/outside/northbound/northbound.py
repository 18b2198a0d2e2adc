"""`[northbound]` at work: the sinks, their feeds, and the metrics' server, for one gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

from drivers.json_lines import format_object
from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.extras import missing_sentence
from gateway.network import application_problem
from gateway.outside.northbound.feed import SinkFeed
from gateway.outside.northbound.sink import SinkContext
from gateway.settings import Config, NorthboundSecrets, load_northbound_secrets
from gateway.store import Historian

if TYPE_CHECKING:
    from concurrent.futures import Future

    from structlog.typing import FilteringBoundLogger

    from gateway.outside.northbound.metrics_server import MetricsServer
    from gateway.outside.northbound.opcua import OpcUaServer
    from gateway.outside.northbound.pictures import Pictures

Answer = Callable[[bytes], Awaitable[Mapping[str, Any]]]
"""Gives the reply to one request of the control socket, in the gateway's loop."""
JOIN_SECONDS = 2.0
LOAD_SECONDS = 60.0
MOST_ASKED = 100
"""Acknowledgements from sinks that wait for their answer at a time, as many as one message may name; what comes beyond
is left out, and logged."""


_METRICS = ("prometheus_client", "gateway.outside.northbound.metrics_server")
_OPCUA = ("asyncua", "gateway.outside.northbound.opcua")
"""What has to be there for the servers: a library, and the module here, which an installation may be without."""


def check_northbound(config: Config) -> NorthboundSecrets:
    """The secrets of the section. Raises ConfigError, before anything runs, for what is missing."""
    section = config.northbound
    kinds = {name: rows[0].kind for name, rows in section.sink_tables.items()}
    wanted = [(name, kind.extra, (*kind.needs, kind.module)) for name, kind in kinds.items()]
    wanted += [("metrics", "prometheus", _METRICS)] if section.metrics.port is not None else []
    wanted += [("opcua", "opcua", _OPCUA)] if section.opcua.port is not None else []
    problems = [
        f"{config.path}: northbound.{name}: {lacking}"
        for name, extra, needs in wanted
        if (lacking := _missing_packages(extra, needs))
    ]
    if problems:
        raise ConfigError(problems)
    if section.opcua.port is not None:
        folder = section.opcua.certificates
        if folder is not None and (problem := application_problem(folder)) is not None:
            raise ConfigError([f"{config.path}: northbound.opcua.certificates: {problem}"])
    return load_northbound_secrets(section)


def _missing_packages(extra: str, needs: Iterable[str]) -> str:
    """What of an extra, or of this program, is not installed; "" if all of it is."""
    try:
        for module in needs:
            import_module(module)
    except ImportError as error:
        return missing_sentence(extra, error)
    return ""


class Northbound:
    """All that is told to other systems, from its making, in the gateway's loop, until `close`.

    `machines` gives the machines' configurations by name, `answer` the reply to a request of the control socket,
    `pictures` what takes each machine's status. `feeds` are the sinks', in the order of the file.
    """

    def __init__(
        self,
        config: Config,
        secrets: NorthboundSecrets,
        *,
        machines: Callable[[], Mapping[str, Config]],
        historian: Historian,
        pictures: Pictures,
        answer: Answer,
        now: Callable[[], float],
        supervisor: Supervisor,
        log: FilteringBoundLogger,
    ) -> None:
        section = config.northbound
        self._machines, self._answer, self._log = machines, answer, log
        self._loop = asyncio.get_running_loop()
        self._asked: list[Future[None]] = []
        context = SinkContext(tags=self._tags, now=now, acknowledge=self._acknowledge)
        self.feeds: Sequence[SinkFeed] = [
            SinkFeed(
                row.name,
                import_module(row.kind.module).make_sink(row, secrets, context),
                path=historian.path,
                machines=lambda: list(machines()),
                view=historian.view,
                now=now,
                tables=row.tables,
                backlog=3600.0 * section.backlog_hours,
                supervisor=supervisor,
                log=log,
            )
            for row in section.sinks
        ]
        self.metrics: MetricsServer | None = None
        if section.metrics.port is not None:
            # What a plant does not use is not loaded, and need not be installed.
            from gateway.outside.northbound.metrics_server import MetricsServer

            self.metrics = MetricsServer(section.metrics, pictures, self.feeds)
            self._thread = supervisor.thread("metrics", self.metrics.run, stop=self.metrics.stop)
        self.opcua: OpcUaServer | None = None
        if section.opcua.port is not None:
            from gateway.outside.northbound.opcua import OpcUaServer

            self.opcua = OpcUaServer(section.opcua, pictures, tags=self._tags, historian=historian.path)
            self._opcua_thread = supervisor.thread("opcua", self.opcua.run, stop=self.opcua.stop)

    @property
    def sink_complaints(self) -> str:
        """Which sinks are out of reach or take nothing, and why; "" while none is."""
        return "; ".join(f"{feed.name}: {complaint}" for feed in self.feeds if (complaint := feed.complaint))

    def _tags(self) -> Mapping[str, Mapping[str, Any]]:
        return {name: config.map.by_name for name, config in self._machines().items()}

    def _acknowledge(self, machine: str, alarms: Sequence[str], by: str) -> None:
        """Acknowledge alarms by the words of the control socket; what comes of it is in the journal and in the log."""
        self._asked = [each for each in self._asked if not each.done()]
        if len(self._asked) >= MOST_ASKED:
            self._log.warning("a command is left out, since too many wait", by=by, machine=machine)
            return
        line = format_object({"command": "acknowledge", "machine": machine, "alarms": list(alarms), "by": by})

        async def ask() -> None:
            reply = await self._answer(line)
            if not reply["ok"]:
                self._log.warning("a command is refused", by=by, machine=machine, reason=str(reply["reason"]))

        with suppress(RuntimeError):  # the gateway's loop has ended
            self._asked.append(asyncio.run_coroutine_threadsafe(ask(), self._loop))

    def wait_load(self) -> None:
        """Wait until all that is large is there. Call it in a thread."""
        if self.opcua is not None:
            self.opcua.loaded.wait(LOAD_SECONDS)

    def close(self) -> None:
        """End all sessions; what was not handed on is, after the next start. Waits, so call it in a thread."""
        if self.metrics is not None:
            self.metrics.close()
        if self.opcua is not None:
            self.opcua.close()
        for feed in self.feeds:
            feed.stop()
        for feed in self.feeds:
            feed.join()
        if self.metrics is not None:
            self._thread.join(JOIN_SECONDS)
        if self.opcua is not None:
            self._opcua_thread.join(JOIN_SECONDS)
