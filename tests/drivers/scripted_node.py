"""A CANopen node of the canopen library (LocalNode): it shares no code with the driver, nor with the software PLC."""

import io
import threading
import time
from collections.abc import Mapping
from pathlib import Path

import can
from canopen import LocalNode, Network
from canopen.objectdictionary.eds import import_eds

from drivers.can.bus.hub_bus import HubBus

NODE = 5
HEARTBEAT = 0.05


def eds(vendor: int = 0x1234) -> str:
    """An EDS with three measured objects in one TPDO, two to write, a text, and one RPDO."""
    objects = [
        ("1000", "Device type", 7, "ro", "0", 0),
        ("1001", "Error register", 5, "ro", "0", 0),
        ("1017", "Producer heartbeat time", 6, "rw", str(round(1000 * HEARTBEAT)), 0),
        ("2200", "Label", 9, "rw", "", 0),
    ]
    records = {
        "1018": [(1, 7, "ro", f"0x{vendor:X}", 0), (2, 7, "ro", "0x77", 0), (4, 7, "ro", "0x1267", 0)],
        "1400": [(1, 7, "rw", "$NODEID+0x200", 0), (2, 5, "rw", "255", 0)],
        "1600": [(1, 7, "rw", "0x21000110", 0), (2, 7, "rw", "0x21000210", 0)],
        "1800": [
            (1, 7, "rw", "$NODEID+0x180", 0),
            (2, 5, "rw", "255", 0),
            (3, 6, "rw", "0", 0),
            (5, 6, "rw", "50", 0),
        ],
        "1A00": [(1, 7, "rw", "0x20010110", 0), (2, 7, "rw", "0x20010210", 0), (3, 7, "rw", "0x20010308", 0)],
        "2001": [(1, 6, "ro", "0", 1), (2, 6, "ro", "0", 1), (3, 5, "ro", "0", 1), (4, 8, "ro", "0", 0)],
        "2100": [(1, 3, "rw", "0", 1), (2, 6, "rw", "0", 1)],
    }
    lines = ["[DeviceInfo]", "VendorName=scripted", ""]
    for index, name, kind, access, default, mapped in objects:
        lines += _section(index, name, kind, access, default, mapped)
    for index, members in records.items():
        lines += [f"[{index}]", f"ParameterName=Record {index}", "ObjectType=0x9", f"SubNumber={len(members) + 1}", ""]
        count = 3 if index == "1A00" else 2 if index == "1600" else members[-1][0]
        lines += _section(f"{index}sub0", "Highest sub-index", 5, "rw", str(count), 0)
        for sub, kind, access, default, mapped in members:
            lines += _section(f"{index}sub{sub:X}", f"Object {sub}", kind, access, default, mapped)
    return "\n".join(lines)


def _section(name: str, title: str, kind: int, access: str, default: str, mapped: int) -> list[str]:
    keys = [f"[{name}]", f"ParameterName={title}", "ObjectType=0x7", f"DataType=0x{kind:04X}", f"AccessType={access}"]
    return [*keys, f"DefaultValue={default}", f"PDOMapping={mapped}", ""]


class ScriptedNode:
    """The node on a hub. `values` are what its measured objects hold (raw, by sub-index of 0x2001)."""

    def __init__(self, path: Path, values: Mapping[int, int], *, vendor: int = 0x1234) -> None:
        self.path, self.values, self.vendor = path, dict(values), vendor
        self.network: Network | None = None
        self.node: LocalNode | None = None

    def start(self) -> None:
        """Join the bus, say so, become operational, and send the TPDO by a timer."""
        network = Network(HubBus(str(self.path)))
        network.NOTIFIER_CYCLE = 0.02
        network.connect()
        node = LocalNode(NODE, import_eds(io.StringIO(eds(self.vendor)), NODE))
        network.add_node(node)
        self.network, self.node = network, node
        for sub, value in self.values.items():
            node.sdo[0x2001][sub].raw = value
        node.nmt.state = "INITIALISING"
        node.nmt.state = "PRE-OPERATIONAL"
        node.nmt.state = "OPERATIONAL"
        network.subscribe(0x200 + NODE, self._rpdo)
        tpdo = node.tpdo[1]
        tpdo.read()
        for number, sub in enumerate((1, 2, 3)):
            tpdo.map[number].raw = self.values[sub]
        tpdo.start(HEARTBEAT)

    def stop(self) -> None:
        """Fall silent in the middle of everything, as a node that loses its power."""
        network, node = self.network, self.node
        self.network = self.node = None
        if network is None or node is None:
            return
        names = {f"Cyclic send task for 0x{base + NODE:X}" for base in (0x180, 0x700)}
        senders = [thread for thread in threading.enumerate() if thread.name in names]
        node.tpdo.stop()
        node.nmt.stop_heartbeat()
        # python-can tells its senders to stop and does not wait for them: one would meet a closed socket.
        for thread in senders:
            thread.join(60.0)
        network.disconnect()

    def _rpdo(self, _: int, data: bytearray, __: float) -> None:
        """The library does not write what an RPDO brings into the dictionary."""
        if self.node is not None:
            self.node.set_data(0x2100, 1, bytes(data[:2]), check_writable=True)
            self.node.set_data(0x2100, 2, bytes(data[2:4]), check_writable=True)

    def say(self, identifier: int, data: bytes) -> None:
        """Send any frame as this node."""
        assert self.network is not None and self.network.bus is not None
        self.network.bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def forget_writes(self) -> None:
        """Confirm writes from now on, and keep nothing."""
        assert self.node is not None
        self.node.set_data = lambda *_, **__: None  # type: ignore[method-assign]

    def value(self, index: int, sub: int) -> object:
        """What an object holds, without the bus."""
        assert self.node is not None
        return self.node.sdo[index][sub].raw


def settle(seconds: float = 0.05) -> None:
    """Let other threads have their turn."""
    time.sleep(seconds)
