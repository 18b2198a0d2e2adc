"""Alarms by ISA-18.2: their states, and which of them a machine has."""

from gateway.machine.alarms.board import AlarmBoard
from gateway.machine.alarms.conditions import (
    CLOCK,
    DEVICE,
    INPUTS,
    OTHER_WRITER,
    PARTS,
    RECORDS,
    acknowledge_words,
    make_conditions,
    name_of,
)
from gateway.machine.alarms.states import AlarmState

__all__ = [
    "CLOCK",
    "DEVICE",
    "INPUTS",
    "OTHER_WRITER",
    "PARTS",
    "RECORDS",
    "AlarmBoard",
    "AlarmState",
    "acknowledge_words",
    "make_conditions",
    "name_of",
]
