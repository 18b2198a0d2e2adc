"""The gateway beside what users would take instead, on the same PLCs: see `benchmarks.peers.__main__`."""

REGISTERS = 10
"""How many registers of each PLC are read, from 0 on."""
