"""The faces of the PLC: each serves the one process image over a fieldbus, all at once where several are asked for.

A face is a row of FACES: the options that it adds to the command line, the one of them that asks for it, and where it
is made. The Modbus TCP face is always there and has no row. What a face looks up in the image it looks up by the
name of the tag; the image itself is made from the Modbus register map.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import click

if TYPE_CHECKING:  # pymodbus and pydantic with them, which no help needs
    from sim.plc.modbus import UnitsBehind
    from sim.plc.program import CycleFaults, Plc

Complain = Callable[[str], None]
_FILE = click.Path(path_type=Path)


class Face(Protocol):
    """One face; `name` is its key in FACES, and what a fault's key `face` says."""

    name: str

    async def open(self) -> None:
        """Begin to serve. Raises OSError with a reason."""
        ...

    async def apply(self, line: "CycleFaults") -> None:
        """Once a cycle: bring the face to what `line` asks for (already narrowed to this face)."""
        ...

    async def close(self) -> None:
        """Stop serving."""
        ...

    def ready(self) -> Mapping[str, object]:
        """Where it serves: its part of the ready line, under `faces` and its name."""
        ...


@dataclass(frozen=True, slots=True)
class FaceKind:
    """A kind of face: `make` is "module:function", called (plc, options, complain) when option `option` is given.

    `units`: it tells machines apart by unit, and so serves those behind this one too.

    `make` gets the options of all faces by their parameters' names, with `host` and `max_clients`. It raises
    InputError.
    """

    option: str
    make: str
    options: tuple[click.Option, ...]
    units: bool = False


def _option(*names: str, **rest: Any) -> click.Option:
    return click.Option(names, show_default=True, **rest)


FACES: dict[str, FaceKind] = {
    "rtu-tcp": FaceKind(
        "rtu_tcp",
        "sim.plc.modbus.server:make_rtu_tcp",
        (_option("--rtu-tcp", type=click.IntRange(0, 65535), help="Modbus RTU frames on this port; 0: a free one."),),
        units=True,
    ),
    "serial": FaceKind(
        "serial",
        "sim.plc.modbus.serial_line:make",
        (
            _option("--serial", metavar="PATH", help="Modbus RTU on this serial port; 'pty' makes a pair of its own."),
            _option("--baud", type=click.IntRange(50), default=19200, help="Bits a second of --serial."),
            _option("--parity", type=click.Choice(["N", "E", "O"]), default="E", help="Parity of --serial."),
            _option("--serial-echo", is_flag=True, help="The line gives back what is sent, as some RS-485 adapters."),
        ),
        units=True,
    ),
    "tls": FaceKind(
        "tls",
        "sim.plc.modbus.tls:make",
        (
            _option("--tls", type=_FILE, metavar="DIR", help="Modbus/TCP Security with the certificates in DIR."),
            _option("--tls-port", type=click.IntRange(0, 65535), default=0, help="Port of --tls; 0: a free one."),
            _option("--tls-role", multiple=True, metavar="ROLE=read|write", help="What a client's role may do."),
        ),
        units=True,
    ),
    "canopen": FaceKind(
        "canopen",
        "sim.plc.canopen.face:make",
        (
            _option("--canopen", type=_FILE, metavar="MAP", help="A CANopen node by this device file and its EDS."),
            _option("--node", type=click.IntRange(1, 63), help="Its node id.  [default: the file's]"),
        ),
    ),
    "can": FaceKind(
        "can",
        "sim.plc.can.face:make",
        (
            _option("--can", type=_FILE, metavar="MAP", help="Raw CAN frames by this device file and its DBC file."),
            _option("--can-channel", default="can0", help="The CAN bus: an interface, or the path of a hub's socket."),
            _option("--can-interface", default="socketcan", help="python-can's name of the interface, or 'hub'."),
        ),
    ),
}
"""Every face beside Modbus TCP; a new one is a row here and a module that makes it."""


def with_faces(command: click.Command) -> click.Command:
    """The command with the options of every face (use as a decorator)."""
    command.params.extend(option for kind in FACES.values() for option in kind.options)
    return command


def face_options(options: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the given options that belong to faces, by their parameters' names."""
    names = {option.name for kind in FACES.values() for option in kind.options}
    return {name: value for name, value in options.items() if name in names}


def make_faces(plc: "Plc", options: Mapping[str, Any], complain: Complain, units: "UnitsBehind | None") -> list[Face]:
    """The faces that the options ask for; those that tell units apart serve `units`.

    A machine behind another one has none of these (`units` is None). Raises InputError.
    """
    from sim.plc.program import InputError

    faces: list[Face] = []
    for kind in FACES.values():
        if options.get(kind.option) is not None:
            if kind.units and units is None:
                option = kind.option.replace("_", "-")
                raise InputError(f"--{option}: a machine behind another one answers over its faces; leave it out here")
            module, _, function = kind.make.partition(":")
            served = units if kind.units else plc
            faces.append(getattr(import_module(module), function)(served, options, complain))
    return faces
