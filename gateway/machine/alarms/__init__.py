"""Alarms by ISA-18.2: their states, and which of them a machine has."""
