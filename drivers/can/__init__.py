"""Raw CAN: any python-can interface, signals by DBC or by plain bit fields, and a bus between processes."""

from drivers.can.dbc import PREFIX, Dbc, layout_conditions, signal_bits
from drivers.can.fields import EXTENDED, Bits, Field, LayoutCondition, decode_value, frame_key, frame_name
from drivers.can.frame import CanFrame, FrameListener, TagReading
from drivers.can.notations import Send, is_message_tag
from drivers.can.reception import Channel, MessageRules, Reception, Slot
from drivers.can.settings import CanSettings, DecodingSettings, PollingSettings
from drivers.can.signals import SignalMap
