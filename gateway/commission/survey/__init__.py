"""An unknown device searched: who answers, what can be read, what is heard."""

from gateway.commission.survey.addresses import (
    LAST,
    AddressTextError,
    Register,
    parse_register,
    parse_stretch,
    reference_of,
)
from gateway.commission.survey.bus_frames import scan_can
from gateway.commission.survey.bus_probe import SDO_S, probe_bus
from gateway.commission.survey.network import (
    addresses_of,
    connect_sentence,
    greeting_of,
    local_end,
    looks_like,
    not_modbus,
)
from gateway.commission.survey.registers import first_register, scan_registers
from gateway.commission.survey.units import scan_nodes, scan_units

__all__ = [
    "LAST",
    "SDO_S",
    "AddressTextError",
    "Register",
    "addresses_of",
    "connect_sentence",
    "first_register",
    "greeting_of",
    "local_end",
    "looks_like",
    "not_modbus",
    "parse_register",
    "parse_stretch",
    "probe_bus",
    "reference_of",
    "scan_can",
    "scan_nodes",
    "scan_registers",
    "scan_units",
]
