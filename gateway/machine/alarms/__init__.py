"""Alarms by ISA-18.2: their states, and which of them a machine has."""

from gateway.machine.alarms.board import AlarmBoard
from gateway.machine.alarms.conditions import DEVICE, make_conditions

__all__ = ["DEVICE", "AlarmBoard", "make_conditions"]
