"""CANopen: one node described by its EDS; PDOs heard as they come, everything else asked for by SDO."""
