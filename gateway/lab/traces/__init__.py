"""`decanter trace`: one module a command, and how commands load traces."""
