"""The links that the demonstration can run over: how the PLC is started, and what the plant file then says."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gateway.console import config_dir
from gateway.demo.can_bus import can_hub, hub_path

Ready = Mapping[str, Any]
"""The ready line of the software PLC; what a face says of itself stands under `faces` and the face's name."""

TIMEOUT_S = 0.3
SYNC_S = 0.02
LONGEST_REPLY_S = 0.5
"""The software PLC answers at once or not at all, unless a fault makes it late."""


@dataclass(frozen=True, slots=True)
class DemoLink:
    """One row: the PLC's `arguments` for a folder, and the driver's `settings` once the PLC is up.

    `device` is the device file under config/devices where it is not the Modbus register map of the demonstration; such
    a link knows the decanter's own tags only. `beside` is what has to run meanwhile, such as a bus between processes.
    """

    arguments: Callable[[Path], Sequence[object]]
    settings: Callable[[Path, Ready], Mapping[str, Any]]
    device: str = ""
    beside: Callable[[Path], AbstractContextManager[object]] = nullcontext


def certificates(folder: Path) -> Path:
    """The demonstration's certificates, made on the spot: they are good for this machine and a few days."""
    from gateway.network import make_all  # cryptography with it, which no help needs

    return make_all(folder / "certificates", hosts=("localhost", "127.0.0.1"), days=7)


def _face(name: str, ready: Ready) -> Mapping[str, Any]:
    face: Mapping[str, Any] = ready["faces"][name]
    return face


def _tcp(_: Path, ready: Ready) -> dict[str, Any]:
    return {"host": ready["host"], "port": ready["port"], "timeout": TIMEOUT_S}


def _tls(folder: Path, ready: Ready) -> dict[str, Any]:
    place = {key: _face("tls", ready)[key] for key in ("host", "port")}
    return {"transport": "tls", **place, "certificates": str(folder / "certificates"), "timeout": TIMEOUT_S}


def _serial(_: Path, ready: Ready) -> dict[str, Any]:
    face = _face("serial", ready)
    line = {"serial": face["path"], "baud": face["baud"], "parity": face["parity"]}
    return {"transport": "rtu", **line, "longest_reply": LONGEST_REPLY_S, "timeout": TIMEOUT_S}


def _rtu_tcp(_: Path, ready: Ready) -> dict[str, Any]:
    face = _face("rtu-tcp", ready)
    place = {"host": face["host"], "port": face["port"]}
    return {"transport": "rtu-tcp", **place, "longest_reply": LONGEST_REPLY_S, "timeout": TIMEOUT_S}


def _can(folder: Path, face: str) -> Sequence[object]:
    """Raw CAN frames, or a CANopen node, over a hub between the two processes."""
    device = config_dir() / "devices" / f"decanter_{face}.toml"
    return f"--{face}", device, "--can-interface", "hub", "--can-channel", hub_path(folder)


def _can_settings(_: Path, ready: Ready) -> dict[str, Any]:
    face = _face("can", ready)
    return {"interface": face["interface"], "channel": face["channel"], "timeout": TIMEOUT_S}


def _canopen_settings(_: Path, ready: Ready) -> dict[str, Any]:
    """The gateway is the master here: it sets the node's PDOs and starts it.

    SYNC comes once a cycle of the PLC's program: a replay moves many times faster than a plant.
    """
    face = _face("canopen", ready)
    where = {"interface": face["interface"], "channel": face["channel"], "node": face["node"]}
    return {**where, "configure": True, "sync_period": SYNC_S, "timeout": TIMEOUT_S}


def _hub(folder: Path) -> AbstractContextManager[object]:
    return can_hub(folder)


DEFAULT_LINK = "modbus"

LINKS: dict[str, DemoLink] = {
    "modbus": DemoLink(lambda folder: (), _tcp),
    "modbus-tls": DemoLink(lambda folder: ("--tls", certificates(folder)), _tls),
    "modbus-rtu": DemoLink(lambda folder: ("--serial", "pty", "--baud", 115200), _serial),
    "modbus-rtu-tcp": DemoLink(lambda folder: ("--rtu-tcp", 0), _rtu_tcp),
    "can": DemoLink(lambda folder: _can(folder, "can"), _can_settings, "decanter_can.toml", _hub),
    "canopen": DemoLink(lambda folder: _can(folder, "canopen"), _canopen_settings, "decanter_canopen.toml", _hub),
}
"""Every link of `decanter demo --link`; a new one is a row here."""
