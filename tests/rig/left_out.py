"""A program without some of its rooms: `python -m tests.rig.left_out ROOM[,ROOM...] WORD...` runs `decanter` so.

An import of such a room fails as if it were not installed. The words `app FILE` make a gateway of a plant file.
"""

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from random import Random
from types import ModuleType

ROOMS = {
    "drivers.vehicle": ("trace", "can", "log.txt", "--device", "obd2", "--out", "out.csv"),
    "sim.lab.checking.smc": ("model", "check", "model", "Pr[<=600](<> Temp >= 80)"),
    "sim.lab.checking.language": ("model", "check", "model", "Pr[<=600](<> Temp >= 80)"),
    "sim.lab.uppaal": ("model", "export", "model", "--uppaal", "--trace", "trace.csv", "--out", "out"),
    "sim.lab.formats.foreign": ("model", "show", "foreign/set"),
    "gateway.lab.fleet": ("model", "learn", "fleet", "machines", "--out", "out"),
    "gateway.lab.ingestion": ("trace", "ingest", "folder", "--into", "archive"),
    "gateway.lab.regression": ("model", "judge", "regression", "store", "--standard", "trace.csv"),
}
"""What serves other needs than to foresee a plant's temperatures, with a command that needs it."""
SINKS = {
    "gateway.outside.northbound.mqtt": '[[northbound.mqtt]]\nname = "it"\nhost = "127.0.0.1"\ntls = false\n',
    "gateway.outside.northbound.postgres": '[[northbound.postgres]]\nname = "it"\nhost = "127.0.0.1"\ndatabase = "d"\n'
    'user = "u"\n',
    "gateway.outside.northbound.influx": '[[northbound.influx]]\nname = "it"\nurl = "http://127.0.0.1:1"\n'
    'database = "d"\n',
    "gateway.outside.northbound.metrics_server": "[northbound.metrics]\nport = 9999\n",
    "gateway.outside.northbound.opcua": "[northbound.opcua]\nport = 9998\n",
}
"""Who else may be told what is on record, with the section of a plant file that asks for it."""


class NotInstalled:
    """Finds no module of the `rooms`, and says so before anybody else is asked."""

    def __init__(self, rooms: Sequence[str]) -> None:
        self.rooms = rooms

    def find_spec(self, name: str, _path: object = None, _target: ModuleType | None = None) -> None:
        """Raise ModuleNotFoundError for a module of the rooms; None, as others find it, for any other one."""
        if any(f"{name}.".startswith(f"{room}.") for room in self.rooms):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def make_gateway(plant: Path) -> None:
    """Load all that a running gateway is made of, and make one of the plant file."""
    from gateway.machine.reading import plant_clock
    from gateway.plant import open_log
    from gateway.plant.fleet import Fleet
    from gateway.settings import load_plant

    import_module("gateway.plant.app")
    with open_log(plant.with_name("log.jsonl")) as log:
        Fleet(load_plant(plant), clock=plant_clock(), log=log, rng=Random(0)).records.close()


def main() -> None:
    """Run the command without the rooms; several commands are parted by the word `then`."""
    rooms, *words = sys.argv[1:]
    sys.meta_path.insert(0, NotInstalled(rooms.split(",")))
    from gateway.cli.main import main as decanter

    while words:
        end = words.index("then") if "then" in words else len(words)
        command, words = words[:end], words[end + 1 :]
        if command[0] == "app":
            make_gateway(Path(command[1]))
            continue
        try:
            decanter(command)
        except SystemExit as left:
            if left.code:
                raise


if __name__ == "__main__":
    main()
