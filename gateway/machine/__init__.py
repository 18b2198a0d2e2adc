"""One machine: a scan passes its stages once, from the link to the records."""

from typing import TYPE_CHECKING

from sim.doors import opened_at_use

if TYPE_CHECKING:
    from gateway.machine.pipeline import ORDERS, Machine
else:
    __getattr__ = opened_at_use(__name__)

__all__ = ["ORDERS", "Machine"]
