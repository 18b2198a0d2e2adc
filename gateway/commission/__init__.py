"""The engineer's hour at the plant: one module for the work of each `decanter plc` command."""
