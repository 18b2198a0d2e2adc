"""Alarms by ISA-18.2: their states, and which of them a machine has."""

from gateway.machine.alarms.board import BY_PERSONS, GATEWAY, AlarmBoard, AlarmError, AlarmListener
from gateway.machine.alarms.conditions import acknowledge_words, make_conditions, name_of, suppressing_tags
from gateway.machine.alarms.journal import JournalRow, read_journal
from gateway.machine.alarms.picture import diagram, state_table, transition_table
from gateway.machine.alarms.rates import PRIORITIES, AlarmFlood, AlarmRates, alarm_rates
from gateway.machine.alarms.sensors import SensorFault, SensorWatch, without_faulty
from gateway.machine.alarms.states import (
    CHANGE_WORDS,
    HIDDEN,
    LETTERS,
    MEANINGS,
    TRANSITIONS,
    UNSEEN,
    Alarm,
    AlarmCondition,
    AlarmState,
    Change,
    Transition,
    possible,
)

__all__ = [
    "BY_PERSONS",
    "CHANGE_WORDS",
    "GATEWAY",
    "HIDDEN",
    "LETTERS",
    "MEANINGS",
    "PRIORITIES",
    "TRANSITIONS",
    "UNSEEN",
    "Alarm",
    "AlarmBoard",
    "AlarmCondition",
    "AlarmError",
    "AlarmFlood",
    "AlarmListener",
    "AlarmRates",
    "AlarmState",
    "Change",
    "JournalRow",
    "SensorFault",
    "SensorWatch",
    "Transition",
    "acknowledge_words",
    "alarm_rates",
    "diagram",
    "make_conditions",
    "name_of",
    "possible",
    "read_journal",
    "state_table",
    "suppressing_tags",
    "transition_table",
    "without_faulty",
]
