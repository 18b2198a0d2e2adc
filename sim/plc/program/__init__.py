"""The PLC's program behind all faces: its image, its cycle, its side of the contract, and the faults that strike it."""

from sim.plc.program.checks import (
    FileTable,
    InputError,
    checked_arguments,
    keyword_signature,
    list_words,
    read_device,
    read_text,
    read_toml,
    validate_entry,
)
from sim.plc.program.clock import EmulatorClock
from sim.plc.program.disturbance import BusDisturbance, NodeDisturbance, disturb_payload, together
from sim.plc.program.encoding import Unrepresentable, encode, encode_absent, is_bool
from sim.plc.program.faults import FaultEffect, OrderedFault, describe, face_shows, merge_effects, parse_fault
from sim.plc.program.image import Undefined
from sim.plc.program.live import LIVE_PLANTS, live_plant
from sim.plc.program.live import status as plant_status
from sim.plc.program.pdu import HEADER, ILLEGAL_FUNCTION, MAX_PDU, ModbusReply, ModbusRequest, crc
from sim.plc.program.plc import Plc, PlcSettings, record_nothing
from sim.plc.program.registers import BlockLayout, Place, parse_address, read_map
from sim.plc.program.replay import TraceReplay, read_trace
from sim.plc.program.schedule import CycleFaults, Scheduled
from sim.plc.program.writeback import Intake, unusable
