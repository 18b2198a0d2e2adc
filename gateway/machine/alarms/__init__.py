"""Alarms by ISA-18.2: their states, and which of them a machine has."""

from gateway.machine.alarms.board import AlarmBoard
from gateway.machine.alarms.conditions import CLOCK, DEVICE, OTHER_WRITER, PARTS, RECORDS, make_conditions
from gateway.machine.alarms.states import AlarmState

__all__ = ["CLOCK", "DEVICE", "OTHER_WRITER", "PARTS", "RECORDS", "AlarmBoard", "AlarmState", "make_conditions"]
