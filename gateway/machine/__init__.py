"""One machine: a scan passes its stages once, from the link to the records, which all machines have in common."""

from typing import TYPE_CHECKING

from sim.doors import lazy_getattr

if TYPE_CHECKING:
    from gateway.machine.followed import FollowedTemperature
    from gateway.machine.phase import Phase
    from gateway.machine.pipeline import MODEL_PART, ORDERS, Machine
    from gateway.machine.plant_records import PlantRecords
    from gateway.machine.records import Keeper
else:
    __getattr__ = lazy_getattr(__name__)
