"""How a command is entered and left: loaded when it is called, exit codes, Control-C."""

from gateway.entry.exits import CallAnswer, Exit, exit_code, fail, print_json, run_answered, sentence, sentences
from gateway.entry.interrupt import interruptible
from gateway.entry.lazy import LazyGroup, Table

__all__ = [
    "CallAnswer",
    "Exit",
    "LazyGroup",
    "Table",
    "exit_code",
    "fail",
    "interruptible",
    "print_json",
    "run_answered",
    "sentence",
    "sentences",
]
