"""Frames on a CAN bus, whatever is in them: opened by name, pumped into the event loop, a bus between processes."""

from drivers.can.bus.access import open_bus
from drivers.can.bus.arrival import ClockBefore
from drivers.can.bus.load import BusLoad, frame_bits
from drivers.can.bus.pump import Pump
from drivers.can.bus.silence import AttendedSilence, pause_between_looks
