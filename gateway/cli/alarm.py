"""`decanter alarm`: the alarms of the running gateway, and what its records say of them."""

from gateway.entry import FirstWordCommand, Table

_COMMANDS = "gateway.cli.plant.commands"
COMMANDS: Table = {
    "list": (f"{_COMMANDS}:list_alarms", "List the alarms that are not normal, the most urgent first."),
    "show": (f"{_COMMANDS}:show_alarm", "Show one alarm: what it watches, what to do, what comes of not doing it."),
    "acknowledge": (f"{_COMMANDS}:acknowledge", "Say that you know: of the named alarms, or of all that wait."),
    "shelve": (f"{_COMMANDS}:shelve", "Put alarms aside for some minutes."),
    "unshelve": (f"{_COMMANDS}:unshelve", "Take alarms back before their time is over."),
    "remove-from-service": (f"{_COMMANDS}:remove_from_service", "Take alarms out for work on what they watch."),
    "return": (f"{_COMMANDS}:return_to_service", "Return alarms to service."),
    "reset": (f"{_COMMANDS}:reset", "Let go of latched alarms."),
    "journal": (f"{_COMMANDS}:journal", "Show what alarms did, and who did what with them."),
    "rates": (f"{_COMMANDS}:rates", "Hold the alarms against what a person can deal with (EEMUA 191)."),
}
EXAMPLES = {
    "list": "alarm list --all",
    "show": "alarm show 'over limit TCuscinettiRiduttore'",
    "acknowledge": "alarm acknowledge --by 'A. Rossi'",
    "shelve": "alarm shelve 'sensor noisy TCuscinettiRiduttore' --minutes 60 --reason 'cable is being changed'",
    "unshelve": "alarm unshelve 'sensor noisy TCuscinettiRiduttore' --reason 'cable is changed'",
    "remove-from-service": "alarm remove-from-service link --reason 'PLC is being exchanged'",
    "return": "alarm return link --reason 'PLC is exchanged'",
    "reset": "alarm reset 'over limit TCuscinettiRiduttore' --reason 'bearing was inspected'",
    "journal": "alarm journal --since 8h",
    "rates": "alarm rates --since 7d --json",
}
alarm = FirstWordCommand(
    "alarm",
    table=COMMANDS,
    examples=EXAMPLES,
    usual="list",
    short_help="Alarms by ISA-18.2.",
    help="See, acknowledge, shelve and count alarms (ISA-18.2, EEMUA 191).",
)
