"""`python -m sim.plc`: the options of the software PLC; the work is loaded when it is asked for."""

from pathlib import Path
from typing import Any

import click

from sim.plc.faces import with_faces


def _explain(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    """List the faults and the commands instead of running."""
    if wanted:
        from sim.plc.control import describe as commands_table
        from sim.plc.program import describe as faults_table

        click.echo(f"{faults_table()}\n\n{commands_table()}")
        context.exit()


def _refuse_old_name(_: click.Context, __: click.Parameter, given: str | None) -> None:
    """Answer the option's name of the last release."""
    if given is not None:
        raise click.UsageError(f"--map is now --device: give --device {given}")


@with_faces
@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.option("--device", "map_path", type=click.Path(path_type=Path), help="Register map (TOML).  [required]")
@click.option("--map", hidden=True, expose_value=False, callback=_refuse_old_name)
@click.option(
    "--trace",
    type=click.Path(path_type=Path),
    help="Trace to replay (wide CSV, first column time); decanter emulate reads any by --columns MAP.",
)
@click.option("--plant", type=click.Choice(("heat",)), help="A live plant instead: it reacts to what is fed.")
@click.option("--trip", type=float, default=80.0, help="Where the drum of --plant trips (degC).")
@click.option(
    "--reduced-feed", type=click.FloatRange(0, 1), default=0.5, help="Share of the feed once the limit is predicted."
)
@click.option("--host", default="127.0.0.1", help="Address to listen on.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="TCP port; 0 takes a free one.")
@click.option("--unit", type=click.IntRange(0, 255), help="The Modbus unit id.  [default: the map's]")
@click.option("--behind", metavar="NAME", help="Be one more unit behind the port and the line of this machine.")
@click.option("--plant-file", type=click.Path(path_type=Path), help="Several machines: [[machine]] tables (TOML).")
@click.option("--machine", multiple=True, metavar="KEY=VALUE,...", help="One of several: name=north,port=15020, ...")
@click.option("--speed", type=float, default=1.0, help="Plant seconds per second.")
@click.option("--epoch", type=float, help="Plant time (s UTC) at --monotonic.  [default: the wall clock now]")
@click.option("--monotonic", type=float, help="Moment of the epoch on CLOCK_MONOTONIC.  [default: now]")
@click.option("--offset", type=float, default=0.0, help="Start at this position of the trace (s from its first row).")
@click.option("--loop", is_flag=True, help="Begin again at the end of the trace.")
@click.option("--hold", is_flag=True, help="Hold the replay until the command 'start'.")
@click.option("--cycle", type=click.FloatRange(0.001, 1.0), default=0.02, help="The program's cycle (s).")
@click.option("--faults", type=click.Path(path_type=Path), help="Schedule of faults (.toml: [[fault]]; .json: a list).")
@click.option("--record", type=click.Path(path_type=Path), help="Append the recording to this file (JSONL).")
@click.option("--seed", type=int, default=0, help="Seed of everything that is drawn.")
@click.option("--permit/--no-permit", default=True, help="The gateway's write permit at the start.")
@click.option(
    "--challenge",
    type=click.IntRange(1, 65535),
    help="The first challenge of the write-back's sessions.  [default: of the wall clock, so that none comes back]",
)
@click.option("--unknown-unit", type=click.Choice(["silent", "exception"]), default="silent", help="A strange unit id.")
@click.option("--max-clients", type=click.IntRange(1), default=16, help="Further connections are closed at once.")
@click.option("--max-registers", type=click.IntRange(1, 125), help="Registers of one request.  [default: the map's]")
@click.option("--writable", multiple=True, metavar="TABLE:N[-M]", help="Test registers that a client may write.")
@click.option("--stdin", is_flag=True, help="Take commands on stdin; its end stops the PLC.")
@click.option(
    "--control-port", type=click.IntRange(0, 65535), help="Take commands on this loopback port; 0: a free one."
)
@click.option(
    "--explain", is_flag=True, is_eager=True, expose_value=False, callback=_explain, help="List faults and commands."
)
@click.pass_context
def main(context: click.Context, /, **options: Any) -> None:
    """Run a software PLC that replays a trace and serves it over Modbus TCP, and whatever other face is asked for.

    With --plant-file or --machine it is several machines in one process; a machine's keys are these options.
    """
    from sim.plc.emulator import emulate as work

    work(context, options)


if __name__ == "__main__":
    main()
