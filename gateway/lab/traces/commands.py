"""The options of `decanter trace` and their help; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from gateway.console import json_option, map_option, seed_option
from gateway.lab.options import picture_option
from sim.lab.recordings.mapping import BLANK_IS_GOOD, CHOICES, NO_COLUMN


@click.command("can", short_help="Decode a CAN log (candump, ASC, BLF, TRC, CSV, MF4) to a table and a CSV.")
@click.argument("log", type=click.Path(path_type=Path))
@click.option(
    "--device", default="obd2", show_default=True, help="Device file with the tags, or a name in config/devices."
)
@click.option("--format", "format_", help="candump, asc, blf, trc, csv or mf4, where the suffix does not say it.")
@click.option("--bus", help="Only this bus of the log, as the log names it (can0, 1 ...).")
@click.option("--dbc", type=click.Path(path_type=Path), help="DBC file, instead of the device file's own.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the readings to this CSV.")
@json_option
def can_log(**options: Any) -> None:
    """Decode a CAN log by the tags of a device file, and say what became of every frame.

    The CSV has a row a reading: time_s (as logged), signal, value, quality; a reading that is not good has the value
    nan. Column maps of the format "long" read it, for OBD-II config/traces/can_obd2.toml.
    """
    from gateway.lab.traces.can import can_log as work

    work(**options)


@click.command("map", short_help="Draft a column map from a CSV: clock, units, switches, temperature, thresholds.")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="The map to write; without it, it is printed.")
@click.option("--overwrite", is_flag=True, help="Replace a map that is there.")
@click.option("--temperature", default="", help="The column that is modelled.")
@click.option(
    "--current",
    multiple=True,
    help=f"The column of the motor's current, or of what else loads the machine; again for several; {NO_COLUMN} for "
    "none.",
)
@click.option("--running", default="", help=f"The column that says whether the machine runs; {NO_COLUMN} for none.")
@click.option("--on", multiple=True, help="A word of that column that means running; may be given several times.")
@click.option("--time", default="", help="The column of times.")
@click.option("--dates", type=click.Choice(CHOICES["dates"]), help="What comes first in 03/04/2024.")
@click.option("--timezone", default="", help="The zone of times that do not say theirs, such as Europe/Rome [UTC].")
@click.option("--unit", multiple=True, help="The unit of a column that does not say it, as 'Bearing temperature=K'.")
@click.option("--machine", default="", help=f"The column that says which machine a row is of; {NO_COLUMN} for none.")
@click.option("--session", default="", help=f"The column that says which session a row is of; {NO_COLUMN} for none.")
@click.option(
    "--good",
    multiple=True,
    help=f"A word of the quality of good readings; {BLANK_IS_GOOD}: also where it is blank; {NO_COLUMN}: it says "
    "nothing.",
)
@click.option("--stored", type=click.Choice(CHOICES["stored"]), help="How values were stored.")
@click.option("--duplicates", type=click.Choice(CHOICES["duplicates"]), help="What becomes of rows with the same time.")
@click.option("--clock-back", type=click.Choice(CHOICES["clock_back"]), help="What becomes of a clock that goes back.")
@click.option("--yes", is_flag=True, help="Take what is most likely wherever a question says it.")
@json_option
def map_command(**options: Any) -> None:
    """Draft a column map from FILE, for `trace show` and `model learn`; FILE may be a folder of one recording's files.

    Finds the clock and its format, separator and decimals, numbers, switches and their words, units, temperature and
    current, machines, sessions, and thresholds. Where two columns fit it asks; off a terminal the option decides that
    it names.
    """
    from gateway.lab.traces.map import map_command as work

    work(**options)


@click.command(short_help="Load traces; say what was used, what was refused and why.")
@click.argument("paths", nargs=-1, required=True)
@map_option
@picture_option
@json_option
def show(**options: Any) -> None:
    """Load traces (files, a folder or a glob) by a column map; say what was used, what was refused and why."""
    from gateway.lab.traces.show import show as work

    work(**options)


@click.command(short_help="Write SYNTHETIC traces as CSV.")
@click.argument("names", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="All scenarios cd1..cd17.")
@click.option("--days", type=click.IntRange(1, 400), help="Production over so many days instead of a scenario.")
@click.option("--cycles", type=click.IntRange(1, 48), default=4, show_default=True, help="Runs a day, with --days.")
@click.option("--period", type=click.FloatRange(0.1, 3600), default=10.0, show_default=True, help="s, with --days.")
@seed_option
@click.option("--out", type=click.Path(path_type=Path), default=Path("out/traces"), show_default=True)
@json_option
def synth(**options: Any) -> None:
    """Write SYNTHETIC traces as CSV: scenarios (cd1 cd8 ...), all of them, or production over several days.

    No plant produced them; every file says so in its first line.
    """
    from gateway.lab.traces.synth import synth as work

    work(**options)
