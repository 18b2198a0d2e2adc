"""`decanter plc`: commissioning, one module a command; what they share is in `gateway.commission.session`."""

from importlib import import_module
from types import ModuleType

import click

from gateway.entry import LazyGroup, Table

COMMANDS: Table = {
    "doctor": (
        "gateway.commission.commands:doctor",
        "Look at this machine before the plant: clock, network, ports, files.",
    ),
    "probe": ("gateway.commission.commands:probe", "Is the device there, does it speak, and who is it?"),
    "scan": ("gateway.commission.scan:scan", "Look for units, nodes, CAN frames, or readable registers."),
    "read": ("gateway.commission.read:read", "Read tags or bare addresses: raw words and values side by side."),
    "guess": (
        "gateway.commission.commands:guess",
        "Find type, word order, scale and address from what the HMI shows.",
    ),
    "watch": ("gateway.commission.commands:watch", "Watch tags as they change."),
    "bind": (
        "gateway.commission.bind:bind",
        "Bind a place in the device to a tag's name; TOML edits keep comments.",
    ),
    "import": (
        "gateway.commission.import_list:import_list",
        "Take the tags of an I/O list (CSV, XLSX) into the device file.",
    ),
    "check": ("gateway.commission.commands:check", "Check the configuration, and with the device every tag of it."),
    "plan": (
        "gateway.commission.commands:plan",
        "The requests of one scan, and their longest time; with --write what would be written.",
    ),
    "verify": (
        "gateway.commission.commands:verify",
        "Compare with the HMI: two values per analogue, both states per bool.",
    ),
    "served": (
        "gateway.commission.commands:served",
        "Where peers find each tag, its quality and its age, if the gateway serves them.",
    ),
    "soak": (
        "gateway.commission.commands:soak",
        "Read for a longer time: cycle times, losses, the period to be recommended.",
    ),
    "codegen": (
        "gateway.commission.writeback.codegen:codegen",
        "Generate the PLC's side of the write-back as Structured Text.",
    ),
    "arm": ("gateway.commission.commands:arm", "Let blocks be written: by whom, why and for how many minutes."),
    "disarm": ("gateway.commission.commands:disarm", "Take the arming back."),
    "test": (
        "gateway.commission.writeback.test:test",
        "Test the PLC's side: alarm bits, heartbeats, the contract; needs an arming.",
    ),
    "audit": ("gateway.commission.commands:audit", "Show and verify the audit log."),
    "report": ("gateway.commission.commands:report", "Make or verify the site acceptance report: page, paper, JSON."),
    "replay": ("gateway.commission.commands:replay", "Send a recording through the gateway, without a PLC."),
}


ELSEWHERE = {
    "write": "`decanter plc plan --write`",
    "loop": "`decanter plc test alarms` and `decanter plc test heartbeat`",
    "conformance": "`decanter plc test conformance`",
}


EXAMPLES = {
    "doctor": "plc doctor",
    "probe": "plc probe --host 192.168.1.10",
    "scan": "plc scan registers holding:0-999 --host 192.168.1.10",
    "read": "plc read 40101 --type float32 --host 192.168.1.10",
    "guess": "plc guess holding:100 72.4 --host 192.168.1.10",
    "watch": "plc watch --config plant.toml",
    "bind": "plc bind Coppia 40104 --type uint16 --scale 0.1 --units % --config plant.toml",
    "import": "plc import io_list.csv --config plant.toml --host 192.168.1.10",
    "check": "plc check --offline",
    "plan": "plc plan --write",
    "verify": "plc verify --against hmi.csv",
    "served": "plc served --config plant.toml",
    "soak": "plc soak --seconds 60",
    "codegen": "plc codegen --target openplc --permit-at %IX0.0 --out block.st",
    "arm": "plc arm --by 'A. Rossi' --reason 'loop test' --minutes 30",
    "disarm": "plc disarm --reason 'tests are done'",
    "test": "plc test alarms --ask",
    "audit": "plc audit",
    "report": "plc report --site 'Plant 1'",
    "replay": "plc replay out/soak.jsonl",
}


class CommissioningGroup(LazyGroup):
    """The group whose commands share the options of the connection, which only its own help lists."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command; its help says where the shared options are."""
        command = super().get_command(ctx, cmd_name)
        if command is not None and any(type(option) is _connection().SharedOption for option in command.params):
            command.epilog = f"Connection, --json and records: see `decanter plc --help`.\n\n{command.epilog}"
        return command

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The group's own options and commands, then the shared options."""
        super().format_options(ctx, formatter)
        titles = ("Connection, after the command's name; else the plant file says it", "Records, after the name too")
        for title, options in zip(titles, _connection().shared_options(), strict=True):
            with formatter.section(title):
                formatter.write_dl([record for option in options if (record := option.get_help_record(ctx))])


def _connection() -> ModuleType:
    """The shared options' module, which is not loaded for the help of `decanter` itself."""
    return import_module("gateway.commission.options")


@click.group(
    cls=CommissioningGroup,
    table=COMMANDS,
    examples=EXAMPLES,
    elsewhere=ELSEWHERE,
    short_help="Commissioning of a PLC.",
)
def plc() -> None:
    """Commission a PLC: look, read, understand, bind, verify. Nothing is written unless armed.

    Every command appends what it did to a file of records, from which the acceptance report is made.

    Exit codes: 0 in order, 1 a check failed, 2 wrong usage or input, 3 cannot connect, 4 the device refused, 5 no
    reply in time, 6 not armed.
    """
