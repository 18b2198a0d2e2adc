"""`decanter plc`: commissioning, one module a command; what they share is in `gateway.commission.session`."""

from importlib import import_module
from types import ModuleType

import click

from gateway.entry import FirstWordCommand, LazyGroup, Table

COMMANDS: Table = {
    "probe": ("gateway.commission.commands:probe", "Is the device there, does it speak, and who is it?"),
    "scan": ("gateway.commission.commands:scan", "Look for units, nodes, CAN frames, or readable registers."),
    "read": (
        "gateway.commission.commands:read",
        "Read tags or bare addresses: raw words and values; --watch: as they change.",
    ),
    "guess": (
        "gateway.commission.commands:guess",
        "Find type, word order, scale and address from what the HMI shows.",
    ),
    "bind": (
        "gateway.commission.commands:bind",
        "Bind a place in the device to a tag's name; TOML edits keep comments.",
    ),
    "import": (
        "gateway.commission.commands:import_list",
        "Take the tags of an I/O list (CSV, XLSX) into the device file.",
    ),
    "check": ("gateway.cli.plc:check", "Check by levels: computer, files, plan, device, HMI, a soak, what is written."),
    "served": (
        "gateway.commission.commands:served",
        "Where peers find each tag, its quality and its age, if the gateway serves them.",
    ),
    "codegen": (
        "gateway.commission.commands:codegen",
        "Generate the PLC's side of the write-back as Structured Text.",
    ),
    "report": ("gateway.commission.commands:report", "Make or verify the site acceptance report: page, paper, JSON."),
    "replay": ("gateway.commission.commands:replay", "Send a recording through the gateway, without a PLC."),
}
CHECKS: Table = {
    "computer": (
        "gateway.commission.commands:doctor",
        "Look at this machine before the plant: clock, network, ports, files.",
    ),
    "files": ("gateway.commission.commands:check_files", "Check the files alone; nothing is asked of the device."),
    "plan": (
        "gateway.commission.commands:plan",
        "The requests of one scan, and their longest time; with --write what would be written.",
    ),
    "device": (
        "gateway.commission.commands:check",
        "Check the configuration, and with the device every tag of it.",
    ),
    "hmi": (
        "gateway.commission.commands:verify",
        "Compare with the HMI: two values per analogue, both states per bool.",
    ),
    "soak": (
        "gateway.commission.commands:soak",
        "Read for a longer time: cycle times, losses, the period to be recommended.",
    ),
    "write": (
        "gateway.commission.commands:test",
        "Test the PLC's side: alarm bits, heartbeats, the contract; needs an arming.",
    ),
}
CHECK_EXAMPLES = {
    "computer": "plc check computer",
    "files": "plc check files",
    "plan": "plc check plan --write",
    "device": "plc check device",
    "hmi": "plc check hmi --against hmi.csv",
    "soak": "plc check soak --seconds 60",
    "write": "plc check write alarms --ask",
}
check = FirstWordCommand(
    "check",
    table=CHECKS,
    examples=CHECK_EXAMPLES,
    usual="device",
    short_help="Check by levels: computer, files, plan, device, HMI, a soak, what is written.",
    help="Check a plant, level by level: each asks more of it than the one before.",
)

ELSEWHERE = {
    "write": "`decanter plc check plan --write`, which shows what would be written; no command writes a register",
    "loop": "`decanter plc check write alarms` and `decanter plc check write heartbeat`",
    "conformance": "`decanter plc check write conformance`",
}


EXAMPLES = {
    "probe": "plc probe --host 192.168.1.10",
    "scan": "plc scan registers holding:0-999 --host 192.168.1.10",
    "read": "plc read 40101 --type float32 --host 192.168.1.10",
    "guess": "plc guess holding:100 72.4 --host 192.168.1.10",
    "bind": "plc bind Coppia 40104 --type uint16 --scale 0.1 --units % --config plant.toml",
    "import": "plc import io_list.csv --config plant.toml --host 192.168.1.10",
    "check": "plc check files",
    "served": "plc served --config plant.toml",
    "codegen": "plc codegen --target openplc --permit-at %IX0.0 --out block.st",
    "report": "plc report --site 'Plant 1'",
    "replay": "plc replay out/soak.jsonl",
}


class CommissioningGroup(LazyGroup):
    """The group whose commands share the options of the connection, which only its own help lists."""

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
