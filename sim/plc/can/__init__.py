"""The raw-frame CAN face of the software PLC."""

from sim.plc.can.station import Station, record
