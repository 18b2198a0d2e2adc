"""The Modbus faces of the software PLC."""

from sim.plc.modbus.server import ModbusServer
from sim.plc.modbus.units import BehindFace, UnitsBehind
