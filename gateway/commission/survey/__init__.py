"""An unknown device searched: who answers, what can be read, what is heard."""

from gateway.commission.survey.addresses import (
    LAST_ADDRESS,
    AddressTextError,
    Register,
    parse_register,
    parse_stretch,
    reference_number,
)
from gateway.commission.survey.bus import SDO_S, probe_bus, scan_can, scan_nodes
from gateway.commission.survey.models import BASES, scan_models
from gateway.commission.survey.network import (
    connect_sentence,
    guess_service,
    local_end,
    not_modbus,
    read_greeting,
    resolve_host,
)
from gateway.commission.survey.registers import ILLEGAL_FUNCTION, first_register, scan_registers
from gateway.commission.survey.units import scan_units
