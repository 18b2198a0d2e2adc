"""The engineer's hour at the plant: one module a command of `decanter plc`, its work and its options."""
