"""`decanter keep`: copies of a gateway, what support needs of it, its former configurations."""

from gateway.entry import FirstWordCommand, Table

KEPT: Table = {
    "backup": ("gateway.cli.keep.commands:backup", "Copy all that a gateway is into a new folder, while it runs."),
    "restore": ("gateway.cli.keep.commands:restore", "Put a backup's files back in their places."),
    "support": ("gateway.cli.keep.commands:support", "Put what support needs into one file, without secrets."),
    "history": ("gateway.cli.keep.commands:history", "List the configurations that were taken over."),
    "diff": (
        "gateway.cli.keep.commands:diff",
        "Show what differs between two configurations, or to the files now.",
    ),
    "rollback": (
        "gateway.cli.keep.commands:rollback",
        "Put the files of a former configuration back, never armed.",
    ),
}
EXAMPLES = {
    "backup": "keep backup /media/usb/gateway-2026-05-04 --config plant.toml",
    "restore": "keep restore /media/usb/gateway-2026-05-04 --by 'A. Rossi'",
    "support": "keep support --config plant.toml",
    "history": "keep history --config plant.toml",
    "diff": "keep diff 3 --config plant.toml",
    "rollback": "keep rollback 3 --reason 'the new limit was wrong' --config plant.toml",
}
keep = FirstWordCommand(
    "keep",
    table=KEPT,
    examples=EXAMPLES,
    short_help="Keep it: backup, restore, support, history, diff, rollback.",
    help="Keep what a gateway is: as a copy, as a file for support, and each configuration that it had.",
)
