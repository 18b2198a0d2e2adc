"""The settings of the raw CAN driver: what each key means, in parts that others take too."""

from typing import Any

from pydantic import Field

from drivers.settings import Reconnecting, Section


class DecodingSettings(Section):
    """How frames are read; a recorded log takes the same. Times in seconds.

    `dbc`: a DBC file. `exact_length`: a frame of another length than the DBC file's is no reading. `timeouts`: a table
    of messages (by name or id) and when their last frame is too old; else it is `timeout_cycles` of the DBC file's
    cycle, at least `least_timeout`; else `message_timeout`.

    For tags of the other notations: whose J1939 parameters (`source`, the engine by default), how old trouble codes
    write an SPN, and the longest age of an answer, for single tags and for all.
    """

    dbc: str | None = Field(None, min_length=1, description="the path of a DBC file")
    exact_length: bool = Field(True, description="true or false")
    timeouts: dict[str, Any] = Field(default_factory=dict, description="a table of messages and seconds")
    message_timeout: float = Field(
        2.0, ge=0.001, le=86_400.0, description="the seconds after which a message is too old, 0.001 to 86400"
    )
    timeout_cycles: float = Field(
        3.0, ge=1.0, le=1000.0, description="the cycles after which a message is too old, 1 to 1000"
    )
    least_timeout: float = Field(
        0.2, ge=0.001, le=60.0, description="the seconds for which no message is too old, 0.001 to 60"
    )
    source: int = Field(0, ge=0, le=0xFD, description="a source address from 0 to 253")
    spn_conversion: int | None = Field(None, ge=1, le=3, description="the version of the SPN conversion, 1 to 3")
    answer_timeout: float = Field(
        10.0, ge=0.001, le=86_400.0, description="the seconds after which an answer is too old, 0.001 to 86400"
    )
    answer_timeouts: dict[str, Any] = Field(default_factory=dict, description="a table of tags and seconds")


class PollingSettings(Section):
    """`poll`: ask at all for OBD-II parameters. Seconds from round to round, and for which an answer is waited for;
    29-bit requests."""

    poll: bool = Field(False, description="true or false")
    poll_period: float = Field(1.0, ge=0.01, le=3600.0, description="the seconds from round to round, 0.01 to 3600")
    poll_timeout: float = Field(0.2, ge=0.01, le=5.0, description="the seconds for an answer, 0.01 to 5")
    poll_29bit: bool = Field(False, description="true or false")


class CanSettings(Reconnecting, DecodingSettings, PollingSettings):
    """Seconds unless named otherwise.

    `interface`, `channel`, `bitrate` (bit/s), `fd` and `options` (passed on): how python-can opens the bus; "hub" is
    the bus between processes of `drivers.can.bus.hub`. `only_mapped`: the interface passes on the frames of tags
    that were asked for and no others, which the bus load then leaves out.

    `echo`: a table of frames that are written, and of the frames by which the device says what it has stored. `pad`:
    the bytes that a plain frame is filled up to. `timeout`: the deadline of an echo.

    `connect_timeout`, `backoff_first`, `backoff_cap`: of opening the bus. `max_silence`: how long without any usable
    frame until it is opened anew, though never before all messages are too old.
    """

    interface: str = Field("socketcan", min_length=1, description="python-can's name of the interface, or 'hub'")
    channel: str = Field(min_length=1, description="the interface's own name of the bus, such as 'can0'")
    bitrate: int = Field(250_000, ge=10_000, le=1_000_000, description="bits a second, 10000 to 1000000")
    fd: bool = Field(False, description="true for CAN FD")
    options: dict[str, Any] | None = Field(None, description="a table of python-can's own options")
    only_mapped: bool = Field(False, description="true to receive the frames of tags alone")
    echo: dict[str, Any] = Field(default_factory=dict, description="a table of frames and their echoes")
    pad: int = Field(0, ge=0, le=64, description="the bytes of a plain frame, 0 to 64")
    timeout: float = Field(0.6, ge=0.001, le=60.0, description="the deadline of an echo in seconds, 0.001 to 60")
    connect_timeout: float = Field(
        1.0, ge=0.001, le=60.0, description="the deadline of opening the bus in seconds, 0.001 to 60"
    )
    max_silence: float = Field(
        2.0, ge=0.001, le=3600.0, description="the seconds without any frame before the bus is opened anew"
    )
