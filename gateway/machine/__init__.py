"""One machine: a scan passes its stages once, from the link to the records."""

from gateway.machine.pipeline import ORDERS, Machine

__all__ = ["ORDERS", "Machine"]
