"""`decanter trace can`: a recorded CAN log decoded by a device file, as a table and as a CSV trace."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from drivers.csv_rows import write_rows
from drivers.driver import open_recording
from drivers.named_files import name_write_errors
from drivers.tag import Sample
from gateway.console import CommandResult, Part, Rows, conclude, make_folder, progress, shipped_file
from gateway.entry import sentences
from gateway.settings import load_device

COLUMNS = ("time_s", "signal", "value", "quality")
_MOST_IDENTIFIERS = 60


def can_log(
    log: Path, device: str, format_: str | None, bus: str | None, dbc: Path | None, out: Path | None, as_json: bool
) -> None:
    """The work of `trace can`."""
    options = {"format": format_, "bus": bus, "dbc": dbc and str(dbc)}
    with sentences(), progress(log.name) as report:
        device_map = load_device(shipped_file("devices", device))
        settings = {**device_map.settings, **{key: value for key, value in options.items() if value is not None}}
        recorded = open_recording(device_map.driver, log, settings, device_map.tags)
        with _sample_writer(out) as keep:
            spans = _spans(keep(recorded.samples(report)))
    rows = []
    for tag in device_map.tags:
        counts = {quality: count for (name, quality), count in recorded.readings.items() if name == tag.name}
        low, high, last = spans.get(tag.name, (None, None, None))
        good = counts.pop("GOOD", 0)
        row = {"tag": tag.name, "address": tag.address, "unit": tag.unit, "good": good, "not_good": counts}
        rows.append(row | {"lowest": low, "highest": high, "last": last})
    identifiers = [[bus, name, count] for (bus, name), count in recorded.identifiers.most_common(_MOST_IDENTIFIERS)]
    data = {
        "tags": rows,
        "counts": dict(recorded.counts()),
        "identifiers": identifiers,
        "log": str(log),
        "out": out and str(out),
        "problem": recorded.problem,
    }
    conclude(CommandResult(data), lambda _: _show(data), as_json=as_json)


@contextmanager
def _sample_writer(out: Path | None) -> Iterator[Any]:
    """A filter that writes the samples on their way to `out`; a file is only there once it is whole."""
    if out is None:
        yield lambda samples: samples
        return
    make_folder(out.parent)
    unfinished = out.with_name(out.name + ".part")
    try:
        with name_write_errors(out), unfinished.open("w", encoding="utf-8", newline="") as stream:
            yield lambda samples: _rows(stream, samples)
        unfinished.replace(out)
    finally:
        unfinished.unlink(missing_ok=True)


def _rows(stream: TextIO, samples: Iterable[Sample]) -> Iterator[Sample]:
    write_rows(stream, [COLUMNS])
    for sample in samples:
        value = sample.value if sample.quality.is_good else "nan"
        cell = int(value) if isinstance(value, bool) else value
        write_rows(stream, [(f"{sample.time:.6f}", sample.tag, cell, sample.quality.name)])
        yield sample


def _spans(samples: Iterable[Sample]) -> dict[str, list[Any]]:
    """By tag: its least and greatest number, and its last good value."""
    spans: dict[str, list[Any]] = {}
    for sample in samples:
        value = sample.value
        if value is None or not sample.quality.is_good:
            continue
        if isinstance(value, str):
            spans[sample.tag] = [None, None, value]
            continue
        low, high, _ = spans.get(sample.tag, (value, value, value))
        spans[sample.tag] = [min(low, value), max(high, value), value]
    return spans


def _show(data: dict[str, Any]) -> Iterator[Part]:
    columns = ("tag", "address", "unit", "good", "not_good", "lowest", "highest", "last")
    yield Rows(
        str(data["log"]),
        columns,
        [["" if row[column] is None else row[column] for column in columns] for row in data["tags"]],
    )
    yield Rows("identifiers", ("bus", "identifier", "frames"), data["identifiers"])
    yield Rows("what became of it", ("count of", "number"), [list(item) for item in data["counts"].items() if item[1]])
    if data["problem"]:
        yield f"not decoded: {data['problem']}"
    if data["out"]:
        yield f"trace: {data['out']}"
