"""Commissioning of what the gateway writes: one module a command, and the suite that a PLC must pass."""
