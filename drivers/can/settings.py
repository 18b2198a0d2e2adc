"""The settings of the raw CAN driver: each with its type, its default and its range."""

from drivers.settings import Setting
from drivers.vehicle.decoding import DECODING, VEHICLE
from drivers.vehicle.obd_poll import POLLING

SETTINGS: dict[str, Setting] = {
    "interface": Setting(str, "socketcan"),
    "channel": Setting(str),
    "bitrate": Setting(int, 250_000, 10_000, 1_000_000),
    "fd": Setting(bool, False),
    "options": Setting(dict, optional=True),
    "only_mapped": Setting(bool, False),
    "echo": Setting(dict, optional=True),
    "pad": Setting(int, 0, 0, 64),
    "timeout": Setting(float, 0.6, 0.001, 60.0),
    "connect_timeout": Setting(float, 1.0, 0.001, 60.0),
    "backoff_first": Setting(float, 0.2, 0.001, 5.0),
    "backoff_cap": Setting(float, 0.5, 0.001, 5.0),
    "max_silence": Setting(float, 2.0, 0.001, 3600.0),
    **DECODING,
    **VEHICLE,
    **POLLING,
}
"""Seconds unless named otherwise.

`interface`, `channel`, `bitrate` (bit/s), `fd` and `options` (passed on): how python-can opens the bus; "hub" is the
bus between processes of `drivers.can.hub`. `only_mapped`: the interface passes on the frames of tags that were asked
for and no others, which the bus load then leaves out.

`dbc`: a DBC file. `exact_length`: a frame of another length than the DBC file's is no reading. `timeouts`: a table of
messages (by name or id) and when their last frame is too old; else it is `timeout_cycles` of the DBC file's cycle, at
least `least_timeout`; else `message_timeout`.

`echo`: a table of frames that are written, and of the frames by which the device says what it has stored. `pad`: the
bytes that a plain frame is filled up to. `timeout`: the deadline of an echo.

`connect_timeout`, `backoff_first`, `backoff_cap`: of opening the bus. `max_silence`: how long without any usable frame
until it is opened anew, though never before all messages are too old.
"""
