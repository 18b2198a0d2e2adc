"""The command `decanter`: sub-commands are imported when they are called, so that help answers at once."""

import click

from gateway.entry import LazyGroup, Table, one_thread

COMMANDS: Table = {
    "demo": (
        "gateway.demo.command:demo",
        "Run the main job end to end on this machine: PLC, gateway, outage, summary, picture.",
    ),
    "run": ("gateway.cli.run:run", "Run the gateway with a configuration file."),
    "emulate": (
        "gateway.cli.emulate:emulate",
        "Start the software PLC, which replays a trace, as a process of its own.",
    ),
    "backup": ("gateway.cli.backup:backup", "Copy all that a gateway is into a new folder, while it runs."),
    "restore": ("gateway.cli.backup:restore", "Put a backup's files back in their places."),
    "certificates": (
        "gateway.cli.certificates:certificates",
        "Make certificates and keys for Modbus/TCP Security.",
    ),
    "diagnose": (
        "gateway.lab.diagnose:diagnose",
        "Find where a model and traces disagree, name what is missing, add it, prove it.",
    ),
    "plc": ("gateway.cli.plc:plc", "Commission a PLC: probe, scan, read, guess, bind, verify, arm."),
    "trace": ("gateway.cli.trace:trace", "Make and look at traces."),
    "model": ("gateway.cli.model:model", "The model laboratory: learn, validate, check and export models."),
}


RENAMED = {"check": "`decanter plc check --offline` for the files alone, `decanter plc check` for the PLC too"}


@click.group(
    "decanter", cls=LazyGroup, table=COMMANDS, renamed=RENAMED, context_settings={"help_option_names": ["-h", "--help"]}
)
@click.version_option(package_name="decanter-gateway")
@click.option("--traceback", is_flag=True, help="Show where in the program an error arose.")
def main(traceback: bool) -> None:
    """Decanter gateway: foresees the bearing temperature of a decanter centrifuge.

    Exit codes: 0 done, 1 a check failed, 2 wrong usage or input, 3 cannot connect, 4 the device refused, 5 timeout,
    6 not armed, 130 stopped by Ctrl-C.
    """
    one_thread()


if __name__ == "__main__":
    main()
