"""`decanter historian`: what is on record, as tables for other programs."""

from gateway.entry import FirstWordCommand, Table

_COMMANDS = "gateway.cli.plant.commands"
COMMANDS: Table = {
    "export": (f"{_COMMANDS}:export", "Write a table of the records as CSV or Parquet."),
    "import": (
        "gateway.lab.ingestion.commands:import_command",
        "Take a recording into a historian; what is there already must agree.",
    ),
    "query": (f"{_COMMANDS}:query", "Show the newest rows of a table, or a tag's means."),
    "tables": (f"{_COMMANDS}:tables", "List the tables and what their columns mean."),
}
EXAMPLES = {
    "export": "historian export samples.parquet --since 7d",
    "import": "historian import export.csv --map export.toml --historian out/recorded.sqlite",
    "query": "historian query samples --tag TCuscinettiRiduttore --since 10m",
    "tables": "historian tables",
}
historian = FirstWordCommand(
    "historian",
    table=COMMANDS,
    examples=EXAMPLES,
    usual="tables",
    short_help="The records as tables.",
    help="Export and query what is on record, a running gateway undisturbed; take recordings into a historian.",
)
