"""How a command is entered and left: loaded when it is called, exit codes, Control-C."""

from gateway.entry.allocator import keep_freed_memory
from gateway.entry.exits import CallAnswer, Exit, exit_code, fail, print_json, run_answered, sentence, sentences
from gateway.entry.interrupt import interruptible
from gateway.entry.lazy import LazyGroup, Table
from gateway.entry.threads import one_thread

__all__ = [
    "CallAnswer",
    "Exit",
    "LazyGroup",
    "Table",
    "exit_code",
    "fail",
    "interruptible",
    "keep_freed_memory",
    "one_thread",
    "print_json",
    "run_answered",
    "sentence",
    "sentences",
]
