"""What may stand in the plant file and in a device file, checked whole before anything starts."""

from gateway.settings.changes import changed_machines
from gateway.settings.config import (
    LEAST_BLOCKS,
    MAX_ARMED_MINUTES,
    Config,
    EnsembleSection,
    ForecastSection,
    HistorianSection,
    LogSection,
    PageSection,
    WritebackSection,
    load_config,
    load_plant,
)
from gateway.settings.devices import BLOCK_FIELDS, DeviceMap, WritebackLayout, load_device
from gateway.settings.links import DeviceLink

__all__ = [
    "BLOCK_FIELDS",
    "LEAST_BLOCKS",
    "MAX_ARMED_MINUTES",
    "Config",
    "DeviceLink",
    "DeviceMap",
    "EnsembleSection",
    "ForecastSection",
    "HistorianSection",
    "LogSection",
    "PageSection",
    "WritebackLayout",
    "WritebackSection",
    "changed_machines",
    "load_config",
    "load_device",
    "load_plant",
]
