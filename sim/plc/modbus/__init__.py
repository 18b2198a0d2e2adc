"""The Modbus faces of the software PLC."""

from sim.plc.modbus.server import ModbusServer

__all__ = ["ModbusServer"]
