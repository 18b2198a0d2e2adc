"""How a command is entered and left: loaded when it is called, exit codes, Control-C."""

from gateway.entry.exits import Exit, exit_code, fail, print_json, run_command, sentence, sentences
from gateway.entry.former import FormerOption
from gateway.entry.interrupt import interruptible
from gateway.entry.lazy import FirstWordCommand, LazyGroup, Table
