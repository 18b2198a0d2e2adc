"""`[northbound]` at work: the table of the kinds of sinks, their feeds, and the metrics' server, for one gateway."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

from drivers.json_lines import packed
from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.northbound.feed import SinkFeed
from gateway.northbound.sink import Sink
from gateway.settings import Config, InfluxRow, MqttRow, NorthboundSecrets, PostgresRow, load_northbound_secrets
from gateway.store import Historian

if TYPE_CHECKING:
    from structlog.typing import FilteringBoundLogger

    from gateway.northbound.metrics_server import MetricsServer, Pictures

Answer = Callable[[bytes], Awaitable[Mapping[str, Any]]]
"""Gives the reply to one request of the control socket, in the gateway's loop."""
SinkRow = MqttRow | PostgresRow | InfluxRow
JOIN_SECONDS = 2.0

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "mqtt": ("paho.mqtt.client", "google.protobuf"),
    "postgres": ("psycopg",),
    "prometheus": ("prometheus_client",),
}
"""The extras of this package, by what their sections need to be imported."""


def check_northbound(config: Config) -> NorthboundSecrets:
    """The secrets of the section. Raises ConfigError, before anything runs, for what is missing."""
    section = config.northbound
    needed = {"mqtt": bool(section.mqtt), "postgres": bool(section.postgres)}
    needed["prometheus"] = section.metrics.port is not None
    for extra, is_needed in needed.items():
        if is_needed:
            key = {"prometheus": "metrics"}.get(extra, extra)
            _load_extra(extra, f"{config.path}: northbound.{key}")
    return load_northbound_secrets(section)


def _load_extra(extra: str, key: str) -> None:
    try:
        for module in EXTRAS[extra]:
            import_module(module)
    except ImportError as error:
        raise ConfigError(
            [f"{key}: needs {error.name}, which is not installed; pip install 'decanter-gateway[{extra}]'"]
        ) from None


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
        self._machines, self._now, self._answer, self._log = machines, now, answer, log
        self._loop = asyncio.get_running_loop()
        self.feeds: Sequence[SinkFeed] = [
            SinkFeed(
                row.name,
                self._sink(row, secrets),
                path=historian.path,
                machines=lambda: list(machines()),
                view=historian.of,
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
            # Here and below: what a plant does not use is not loaded, and need not be installed.
            from gateway.northbound.metrics_server import MetricsServer

            self.metrics = MetricsServer(section.metrics, pictures, self.feeds)
            self._thread = supervisor.thread("metrics", self.metrics.run, stop=self.metrics.stop)

    def _sink(self, row: SinkRow, secrets: NorthboundSecrets) -> Sink:
        password = secrets.passwords.get(row.name)
        if isinstance(row, MqttRow):
            from gateway.northbound.mqtt import JsonSink, SparkplugSink

            if row.payload == "json":
                return JsonSink(row, password, acknowledge=self._acknowledge)
            return SparkplugSink(row, password, tags=self._tags, now=self._now, acknowledge=self._acknowledge)
        if isinstance(row, PostgresRow):
            from gateway.northbound.postgres import PostgresSink

            return PostgresSink(row, password)
        from gateway.northbound.influx import InfluxSink

        return InfluxSink(row, password, secrets.tokens.get(row.name))

    def _tags(self) -> Mapping[str, Mapping[str, Any]]:
        return {name: config.map.by_name for name, config in self._machines().items()}

    def _acknowledge(self, machine: str, alarms: Sequence[str], by: str) -> None:
        """Acknowledge alarms by the words of the control socket; what comes of it is in the journal and in the log."""
        line = packed({"command": "acknowledge", "machine": machine, "alarms": list(alarms), "by": by})

        async def ask() -> None:
            reply = await self._answer(line)
            if not reply["ok"]:
                self._log.warning("a command is refused", by=by, machine=machine, reason=str(reply["reason"]))

        with suppress(RuntimeError):  # the gateway's loop has ended
            asyncio.run_coroutine_threadsafe(ask(), self._loop)

    def close(self) -> None:
        """End all sessions; what was not handed on is, after the next start. Waits, so call it in a thread."""
        if self.metrics is not None:
            self.metrics.close()
        for feed in self.feeds:
            feed.stop()
        for feed in self.feeds:
            feed.join()
        if self.metrics is not None:
            self._thread.join(JOIN_SECONDS)
