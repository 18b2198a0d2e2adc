"""What a driver's devices are like, as data: code asks for a capability and never for a driver's name.

It imports no driver: what a command can do over a link is known before anything is opened.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from drivers.tap import Medium

BlockKind = Literal["", "words", "frames"]
"""How a write-back block travels: as neighbouring words of one request, of which a part is a write too; as several
frames, which count together or not at all; "" not at all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capabilities:
    """One driver: the functions that do its work, and what its devices have.

    `opens`, `surveys`, `plans`, `decodes`, `locates`, `shares` and `identifies` are `module:function`: what opens the
    driver, asks its device by hand (`drivers.survey`), plans a scan beforehand, decodes a recording at once, says where
    a tag lies (table, first address, count), what tells the connection that settings lead to from another, and what
    tells the device at its end from another; "" where there is no such thing.

    `speaks`: the device speaks by itself, and a scan takes what it has said; else it is polled. `registers`: values lie
    in the tables of a Modbus device. `units`: several devices answer behind one connection. `nodes`: objects of a
    CANopen node, asked for by SDO. `bus`: frames of a CAN bus can be listened to. `block`: how a block is written to
    it. `networked`: `host`, `port` and `timeout` of `[device]` say where it is. `certificates`: it may hold some, about
    which there can be cautions.

    `described_in` is where a person finds what lies where and in which type. `files` are the settings that name files
    or folders. `requests` are the counters of its statistics that count requests on the wire.
    """

    opens: str
    surveys: str = ""
    plans: str = ""
    decodes: str = ""
    locates: str = ""
    shares: str = ""
    identifies: str = ""
    speaks: bool = False
    registers: bool = False
    units: bool = False
    nodes: bool = False
    bus: bool = False
    block: BlockKind = ""
    networked: bool = False
    certificates: bool = False
    described_in: str = "the device's manual"
    files: frozenset[str] = frozenset()
    requests: tuple[str, ...] = ("requests",)

    @property
    def writes(self) -> bool:
        """True if a block can be written to its devices."""
        return bool(self.block)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkKind:
    """One way to reach a device, as `--link` names it: its driver, and the `settings` that make it this one.

    `medium` is what its frames are, `needs` are the settings without which nothing can be reached, `defaults` those
    that are filled in where no device file says better. `sign` is a setting that only this kind of the driver has.
    `line`: frames as on a serial line, where a reply may take long. `mistaken_for`: the kind whose frames the same
    port could want instead.
    """

    driver: str
    medium: Medium
    needs: tuple[str, ...]
    settings: Mapping[str, Any] = field(default_factory=dict)
    defaults: Mapping[str, Any] = field(default_factory=dict)
    sign: str = ""
    line: bool = False
    mistaken_for: str = ""
