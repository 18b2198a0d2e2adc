"""Alarms by ISA-18.2: their states, and which of them a machine has."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.machine.alarms.board import GATEWAY, AlarmBoard, AlarmError
    from gateway.machine.alarms.conditions import acknowledge_words, alarm_name, make_conditions, suppressing_tags
    from gateway.machine.alarms.journal import JournalRow, StoredRow, read_journal
    from gateway.machine.alarms.picture import diagram, state_table, transition_table
    from gateway.machine.alarms.rates import FLOOD_BEGIN_COUNT, PRIORITIES, TEN_MINUTES, alarm_rates
    from gateway.machine.alarms.sensors import SensorWatch, without_faulty
    from gateway.machine.alarms.states import (
        ACTIVE,
        BY_PERSONS,
        HIDDEN,
        LETTERS,
        MEANINGS,
        TRANSITIONS,
        UNSEEN,
        Alarm,
        AlarmCondition,
        AlarmState,
        Change,
        possible,
    )
else:
    __getattr__ = lazy_getattr(__name__)
