"""`decanter plc served`: where peers find each tag, its quality and its age, if the gateway serves them."""

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from drivers.csv_rows import write_rows
from gateway.console import CommandResult, Part, Rows, conclude, find_plant_file
from gateway.entry import sentences
from gateway.outside.serving import served_rows
from gateway.settings import load_config

_COLUMNS = ("tag", "table", "address", "count", "dtype", "order", "scale", "offset", "units", "quality", "age")


def served(path: Path | None, machine: str | None, as_csv: bool, as_json: bool) -> None:
    """Carry out `decanter plc served`; its options and its help are in commission/commands.py."""
    with sentences():
        config = load_config(path or find_plant_file(), machine=machine)
        rows = [
            {
                "tag": row.tag.name,
                "table": row.table,
                "address": row.start,
                "count": row.count,
                "dtype": str(row.tag.dtype) if row.tag.bit is None else f"bit {row.tag.bit}",
                "order": str(row.tag.order),
                "scale": row.tag.scale,
                "offset": row.tag.offset,
                "units": row.tag.unit,
                "quality": row.quality,
                "age": row.age,
            }
            for row in served_rows(config)
        ]
    serve = config.serve
    if as_csv:
        text = io.StringIO()
        write_rows(text, (_COLUMNS, *([row[column] for column in _COLUMNS] for row in rows)))
        click.echo(text.getvalue(), nl=False)
        return
    place = {"host": serve.host, "port": serve.port, "unit": serve.unit, "state": serve.address}
    conclude(CommandResult({**place, "tags": rows}), _view, as_json=as_json)


def _view(place: Mapping[str, Any]) -> Iterator[Part]:
    where = (
        f"{place['host']}:{place['port']} unit {place['unit']}" if place["port"] else "not served: [serve] has no port"
    )
    shown = [{"place": f"{row['table']}:{row['address']}", **row} for row in place["tags"]]
    columns = ["place", *(name for name in _COLUMNS if name not in ("table", "address"))]
    yield Rows(where, columns, shown)
    state = place["state"]
    yield (
        f"holding and input registers {state}: layout, {state + 1}: scans, {state + 2}: age of the last scan in 0.1 s, "
        f"{state + 3}: tags; then quality (OPC UA, upper half: 0 good) and age in 0.1 s of each"
    )
