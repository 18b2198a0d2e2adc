"""The command `decanter`: tables of commands, and those that run the gateway itself."""
