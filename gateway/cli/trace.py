"""`decanter trace`: make synthetic traces, look at recorded ones, take files from elsewhere."""

import click

from gateway.entry import LazyGroup, Table

COMMANDS: Table = {
    "can": (
        "gateway.lab.traces.commands:can_log",
        "Decode a CAN log (candump, ASC, BLF, TRC, CSV, MF4) to a table and a CSV.",
    ),
    "ingest": (
        "gateway.lab.ingestion.commands:ingest",
        "Take a folder's files into an archive: recognised, copied, listed; doubles refused.",
    ),
    "map": (
        "gateway.lab.traces.commands:map_command",
        "Draft a column map from a CSV: clock, units, switches, temperature, thresholds.",
    ),
    "show": ("gateway.lab.traces.commands:show", "Load traces; say what was used, what was refused and why."),
    "synth": ("gateway.lab.traces.commands:synth", "Write SYNTHETIC traces as CSV."),
}


EXAMPLES = {
    "can": "trace can trip.asc --device obd2 --out out/trip.csv",
    "ingest": "trace ingest /media/usb/export --into archive",
    "map": "trace map export.csv --out my_map.toml",
    "show": "trace show out/traces/cd8.csv",
    "synth": "trace synth cd8 --out out/traces",
}


@click.group(cls=LazyGroup, table=COMMANDS, examples=EXAMPLES)
def trace() -> None:
    """Make and look at traces."""
