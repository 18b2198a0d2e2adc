"""The engineer's hour at the plant: one module a command of `decanter plc`.

A module has the command's work, which gives a `CommandResult`, what a person sees of it (its view), and its options;
those of most stand in `commands`, so that a help text loads none of the work.
"""
