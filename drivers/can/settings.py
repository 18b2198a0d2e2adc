"""The settings of the raw CAN driver: each with its type, its default and its range."""

from drivers.settings import Setting

DECODING: dict[str, Setting] = {
    "dbc": Setting(str, optional=True),
    "exact_length": Setting(bool, True),
    "timeouts": Setting(dict, optional=True),
    "message_timeout": Setting(float, 2.0, 0.001, 86_400.0),
    "timeout_cycles": Setting(float, 3.0, 1.0, 1000.0),
    "least_timeout": Setting(float, 0.2, 0.001, 60.0),
}
"""How frames are read; a recorded log takes the same."""

VEHICLE: dict[str, Setting] = {
    "source": Setting(int, 0, 0, 0xFD),
    "spn_conversion": Setting(int, None, 1, 3, optional=True),
    "answer_timeout": Setting(float, 10.0, 0.001, 86_400.0),
    "answer_timeouts": Setting(dict, optional=True),
}
"""For tags of the other notations: whose J1939 parameters (`source`, the engine by default), how old trouble codes
write an SPN, and the longest age of an answer, for single tags and for all. A recorded log takes the same."""

POLLING: dict[str, Setting] = {
    "poll": Setting(bool, False),
    "poll_period": Setting(float, 1.0, 0.01, 3600.0),
    "poll_timeout": Setting(float, 0.2, 0.01, 5.0),
    "poll_29bit": Setting(bool, False),
}
"""`poll`: ask at all for OBD-II parameters. Seconds from round to round, and for which an answer is waited for; 29-bit
requests."""

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
