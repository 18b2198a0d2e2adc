"""The command `decanter`: sub-commands are imported when they are called, so that help answers at once."""

from importlib import import_module

import click

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": (
        "gateway.cli.demo:demo",
        "Run the main job end to end on this machine: PLC, gateway, outage, summary, picture.",
    ),
    "run": ("gateway.cli.run:run", "Run the gateway with a configuration file."),
    "check": (
        "gateway.cli.run:check",
        "Check a configuration, its register map and its model; with --connect the PLC too.",
    ),
    "emulate": (
        "gateway.cli.emulate:emulate",
        "Start the software PLC, which replays a trace, as a process of its own.",
    ),
    "trace": ("gateway.cli.trace:trace", "Make and look at traces."),
    "model": ("gateway.cli.model:model", "Learn, look at and simulate models."),
}


class LazyGroup(click.Group):
    """A group whose commands are modules, imported when one of them is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """The names in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command, or None for a name that is not in the table."""
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name][0].partition(":")
        command = getattr(import_module(module), attribute)
        if not isinstance(command, click.Command):
            raise TypeError(f"{COMMANDS[cmd_name][0]} is no command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list in the help text, from the table: no command is imported for it."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="decanter-gateway")
@click.option("--traceback", is_flag=True, help="Show where in the program an error arose.")
def main(traceback: bool) -> None:
    """Decanter gateway: foresees the bearing temperature of a decanter centrifuge.

    Exit codes: 0 done, 1 a check failed, 2 wrong usage or input, 3 cannot connect, 4 the device refused, 5 timeout,
    6 not armed, 130 stopped by Ctrl-C.
    """


if __name__ == "__main__":
    main()
