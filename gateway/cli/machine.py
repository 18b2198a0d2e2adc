"""`decanter machine`: the machines of a plant file."""

from gateway.entry import FirstWordCommand, Table

COMMANDS: Table = {
    "list": ("gateway.cli.plant.commands:list_machines", "List the machines, and how they are where a gateway runs."),
    "add": ("gateway.cli.plant.commands:add_machine", "Add a machine to the plant file."),
    "remove": ("gateway.cli.plant.commands:remove_machine", "Take a machine out of the plant file; its records stay."),
}
EXAMPLES = {
    "list": "machine list --config plant.toml",
    "add": "machine add decanter2 --host 192.168.1.11 --config plant.toml",
    "remove": "machine remove decanter2 --config plant.toml",
}
machine = FirstWordCommand(
    "machine",
    table=COMMANDS,
    examples=EXAMPLES,
    usual="list",
    help="List, add and remove the machines of a plant.",
)
