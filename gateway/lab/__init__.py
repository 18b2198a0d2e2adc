"""The laboratory: one module a command of `decanter model`, its work and its options."""
