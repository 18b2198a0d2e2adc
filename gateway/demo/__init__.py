"""The demonstration: a software PLC and a gateway as separate processes, one outage, and a summary of what came out."""
