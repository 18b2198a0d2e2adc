"""Structured logs: JSON lines to a file, short lines to a console. Set up by a call, never by an import."""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, TextIO

from gateway.plant.folding import WINDOW_SECONDS, Folding
from gateway.plant.log_file import LogFile
from gateway.settings import LogSection
from sim.strict_json import escape_text, strict


@contextmanager
def _hide_library(library: str) -> Iterator[None]:
    """Within, an import of the library fails as if it were not installed, unless it is loaded already."""
    if library in sys.modules:
        yield
        return
    sys.modules[library] = None  # type: ignore[assignment]  # as the import system has it: ModuleNotFoundError
    try:
        yield
    finally:
        del sys.modules[library]


# structlog loads rich, where it finds it, to draw tracebacks; those of this log are plain text before they are shown.
with _hide_library("rich"):
    import structlog
    from structlog.typing import FilteringBoundLogger, Processor

LEVELS = {"debug": logging.DEBUG, "info": logging.INFO, "warning": logging.WARNING, "error": logging.ERROR}
_STAMP = structlog.processors.TimeStamper(fmt="iso", utc=True)

_Sink = tuple[Processor, Callable[[str], None], frozenset[str]]
"""How an event becomes a text, where that goes, and the events that do not go there."""


class _Tee:
    """Writes each finished event to every sink, repetitions folded; a sink that fails does not silence the others."""

    def __init__(self, sinks: list[_Sink], folding: Folding) -> None:
        self.sinks = sinks
        self._folding = folding
        # Reentrant: a signal's handler may log while a line is being written by the same thread.
        self._lock = threading.RLock()
        self._timer: threading.Timer | None = None

    def msg(self, **event: Any) -> None:
        now = time.monotonic()
        with self._lock:
            self._write_due(now)
            if self._folding.take(event, now):
                self._write(event)
            elif self._timer is None:
                # The count is written also where no line comes any more.
                self._timer = threading.Timer(self._folding.window, self._on_time)
                self._timer.daemon, self._timer.name = True, "log"
                self._timer.start()

    debug = info = warning = error = critical = msg

    def close(self) -> None:
        """Write what was kept back."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            self._write_due(time.monotonic(), at_once=True)

    def _on_time(self) -> None:
        with self._lock:
            self._timer = None
            self._write_due(time.monotonic(), at_once=True)

    def _write_due(self, now: float, *, at_once: bool = False) -> None:
        for event in self._folding.due(now, at_once=at_once):
            self._write(event)

    def _write(self, event: Mapping[str, Any]) -> None:
        for render, write, without in self.sinks:
            if event.get("event") in without:
                continue
            try:
                write(str(render(None, "msg", _STAMP(None, "msg", dict(event)))))
            except (OSError, ValueError):
                continue


def _printable(_logger: object, _name: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Line breaks, ESC and what else steers a terminal or makes two lines of one are written as escapes.

    Reasons hold what devices, files and other programs have said. A traceback keeps its lines.
    """
    for key, value in event.items():
        event[key] = (
            "\n".join(map(escape_text, value.split("\n"))) if key == "exception" else escape_text(strict(value))
        )
    return event


def log_file(path: Path, rotation: LogSection, *, patient: bool = False) -> LogFile:
    """The file of a log. Raises OSError for a path that cannot be written, unless it is `patient`."""
    size = int(rotation.max_mb * 1_000_000)
    return LogFile(path, max_bytes=size, max_days=rotation.max_days, keep=rotation.keep, patient=patient)


@contextmanager
def open_log(
    path: Path | LogFile | None,
    level: str = "info",
    console: TextIO | None = None,
    *,
    rotation: LogSection | None = None,
    fold_seconds: float = WINDOW_SECONDS,
    console_without: frozenset[str] = frozenset(),
) -> Iterator[FilteringBoundLogger]:
    """A logger that writes to `path`, or an open file, as JSON lines, and to `console` for people until the block ends.

    With neither, it writes to standard error. The console does not get the events `console_without`, of which people
    hear by another way. `rotation` says how large and how old the file becomes. Lines that
    differ in numbers only are folded over `fold_seconds` (real). Raises OSError for a path that cannot be written.
    """
    sinks: list[_Sink] = []
    with ExitStack() as opened:
        if path is not None:
            file = path if isinstance(path, LogFile) else log_file(path, rotation or LogSection())
            opened.callback(file.close)
            sinks.append((structlog.processors.JSONRenderer(ensure_ascii=False), file.write, frozenset()))
        if console is not None or path is None:
            stream = console or sys.stderr

            def show(line: str) -> None:
                stream.write(line + "\n")
                stream.flush()

            sinks.append((structlog.dev.ConsoleRenderer(colors=stream.isatty()), show, console_without))
        tee = _Tee(sinks, Folding(fold_seconds))
        opened.callback(tee.close)
        yield _logger(tee, level)


def _logger(tee: _Tee, level: str) -> FilteringBoundLogger:
    logger: FilteringBoundLogger = structlog.wrap_logger(
        tee,
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.ExceptionRenderer(),
            _printable,
            lambda _logger, _name, event: ((), event),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(LEVELS[level]),
        cache_logger_on_first_use=False,
    )
    return logger
