"""Structured logs: JSON lines to a file, short lines to a console. Set up by a call, never by an import."""

import logging
import sys
from collections.abc import Iterator, MutableMapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TextIO

import structlog
from structlog.typing import FilteringBoundLogger, Processor

from sim.strict_json import escaped

LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}


class _Tee:
    """Writes each finished event to every sink; a sink that fails does not silence the others."""

    def __init__(self, sinks: list[tuple[Processor, TextIO]]) -> None:
        self.sinks = sinks

    def msg(self, **event: object) -> None:
        for render, stream in self.sinks:
            try:
                stream.write(str(render(None, "msg", dict(event))) + "\n")
                stream.flush()
            except (OSError, ValueError):
                continue

    debug = info = warning = error = critical = msg


def _printable(_logger: object, _name: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Line breaks, ESC and what else steers a terminal or makes two lines of one are written as escapes.

    Reasons hold what devices, files and other programs have said. A traceback keeps its lines.
    """
    return {key: value if key == "exception" else escaped(value) for key, value in event.items()}


@contextmanager
def open_log(path: Path | None, level: str = "info", console: TextIO | None = None) -> Iterator[FilteringBoundLogger]:
    """A logger that writes to `path` (JSON lines, appended) and to `console` (for people) until the block ends.

    With neither, it writes to standard error. Raises OSError for a path that cannot be written.
    """
    sinks: list[tuple[Processor, TextIO]] = []
    with ExitStack() as files:
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            stream = files.enter_context(path.open("a", encoding="utf-8"))
            sinks.append((structlog.processors.JSONRenderer(ensure_ascii=False), stream))
        if console is not None or path is None:
            console = console or sys.stderr
            sinks.append((structlog.dev.ConsoleRenderer(colors=console.isatty()), console))
        yield _logger(sinks, level)


def _logger(sinks: list[tuple[Processor, TextIO]], level: str) -> FilteringBoundLogger:
    logger: FilteringBoundLogger = structlog.wrap_logger(
        _Tee(sinks),
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.ExceptionRenderer(),
            _printable,
            lambda _logger, _name, event: ((), event),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(LEVELS[level]),
        cache_logger_on_first_use=False,
    )
    return logger
