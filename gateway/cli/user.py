"""`decanter user`: the accounts of the page, made at the box."""

from gateway.entry import FirstWordCommand, Table

COMMANDS: Table = {
    "add": ("gateway.cli.plant.commands:add_account", "Make an account; its password is asked for."),
    "list": ("gateway.cli.plant.commands:list_accounts", "List the accounts and what each may do."),
    "password": ("gateway.cli.plant.commands:change_password", "Give an account another password; its sessions end."),
    "remove": ("gateway.cli.plant.commands:remove_account", "Remove an account; its sessions end."),
}
EXAMPLES = {
    "add": "user add rossi --role operator --config plant.toml",
    "list": "user list --config plant.toml",
    "password": "user password rossi --config plant.toml",
    "remove": "user remove rossi --config plant.toml",
}
user = FirstWordCommand("user", table=COMMANDS, examples=EXAMPLES, usual="list", help="Accounts of the page.")
