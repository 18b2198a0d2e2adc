"""Our contender as users run it: `decanter run` with a plant file of many machines, its PLCs those of `plcs.c`.

Of the ten registers each machine has a heartbeat, the temperature, the current and the switch that a model reads; where
blocks are written, the PLCs' words beside them say that they may be, and the block lies from register BLOCK on.
"""

import socket
import struct
import sys
from pathlib import Path

from benchmarks.peers import REGISTERS
from sim.artefacts.model_json import model_text
from tests.rig.pair import MAP, known_model

PERMIT, CHALLENGE, BLOCK = 10, 11, 100
_MINUTES = 60


def device_text(*, blocks: bool) -> str:
    """The device file. What `plcs.c` has in its registers makes 50 to 53 degC, 200 to 205 A, and always running."""
    tags = [
        '[[tags]]\nname = "PlcHeartbeat"\naddress = "holding:0"\ndtype = "uint16"',
        '[[tags]]\nname = "TCuscinettiRiduttore"\naddress = "holding:1"\ndtype = "uint16"\nscale = 0.05\nunit = "degC"',
        '[[tags]]\nname = "Assorbimento"\naddress = "holding:2"\ndtype = "uint16"\nscale = 0.1\nunit = "A"',
        '[[tags]]\nname = "MarciaDecanter"\naddress = "holding:3"\ndtype = "bool"\nbit = 8',
    ]
    tags += [
        f'[[tags]]\nname = "r{number}"\naddress = "holding:{number}"\ndtype = "uint16"'
        for number in range(4, REGISTERS)
    ]
    head = '[device]\nname = "peer"\ndriver = "modbus"\nunit = 1\nheartbeat = "PlcHeartbeat"'
    if not blocks:
        return "\n".join((head, *tags)) + "\n"
    tags += [
        f'[[tags]]\nname = "WritePermit"\naddress = "holding:{PERMIT}"\ndtype = "bool"\nbit = 0',
        f'[[tags]]\nname = "Challenge"\naddress = "holding:{CHALLENGE}"\ndtype = "uint16"',
    ]
    shipped = MAP.read_text(encoding="utf-8")
    fields = shipped[shipped.index("fields = [") :].partition("]\n")[0]
    block = f'[writeback]\ntemperature = "TCuscinettiRiduttore"\naddress = "holding:{BLOCK}"\nlayout_version = 2'
    return "\n".join((head, *tags, f"{block}\ntimeout_s = 5.0\nunknown = 65535\n{fields}]")) + "\n"


def plant_command(folder: Path, *, port: int, count: int, period: float, blocks: bool) -> list[str]:
    """Write the files of a plant and have its PLCs permit blocks; gives the command that runs it."""
    (folder / "device.toml").write_text(device_text(blocks=blocks), encoding="utf-8")
    lines = [
        '[device]\nfile = "device.toml"\ntimeout = 0.3\nheartbeat_period = 0.2',
        f"[scan]\nperiod = {period:g}",
        '[historian]\npath = "historian.sqlite"\nmax_interval = 60',
        '[log]\npath = "log.jsonl"',
    ]
    if blocks:
        (folder / "model.json").write_text(model_text(known_model()), encoding="utf-8")
        words = f'armed_by = "benchmark"\nreason = "peers"\nminutes = {_MINUTES}'
        lines += ['[model]\npath = "model.json"', f'[writeback]\nmode = "armed"\n{words}']
        for number in range(count):
            _permit(port + number)
    lines += [
        f'[[machine]]\nname = "plc{number}"\ndevice = {{ host = "127.0.0.1", port = {port + number} }}'
        for number in range(count)
    ]
    file = folder / "plant.toml"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [sys.executable, "-m", "gateway.cli.main", "run", "--config", str(file), "--quiet", "--stdin"]


def _permit(port: int) -> None:
    """Set the permit and a challenge in a PLC, by function 6."""
    with socket.create_connection(("127.0.0.1", port)) as line:
        for register, value in ((PERMIT, 1), (CHALLENGE, 7)):
            line.sendall(struct.pack(">HHHBBHH", 1, 0, 6, 1, 6, register, value))
            line.recv(12)
