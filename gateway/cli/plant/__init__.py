"""Commands of a plant that runs: the gateway, its machines, alarms, records and people."""
