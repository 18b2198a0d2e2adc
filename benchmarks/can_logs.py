"""Decoding of recorded CAN logs: frames per second against python-can's bare reader, and how right real logs come out.

The log is synthetic: OBD-II answers of one and of several frames, J1939 parameters and broadcasts by the transport
protocol, written as `candump -L`. The limit is python-can's own reader over the same file, which decodes nothing. Peak
memory is that of Python's allocator while the log is decoded, for the log and for one of a tenth of its size. With
`--data FOLDER` (../shared/data/can_obd2 by default, if it is there) every decoded value of the car's recording is
compared with the table that came with it, and every frame of the truck's recording is accounted for.
"""

import csv
import tempfile
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import can
import click

from benchmarks.figures import Figure, best, give
from drivers.driver import open_recording
from drivers.tag import Sample
from gateway.settings.devices import load_device

ROOT = Path(__file__).parents[1]
DATA = ROOT.parent / "shared" / "data" / "can_obd2"
FRAMES = 300_000
_VIN = b"\x10\x14\x49\x02\x01VWV", b"\x21WZZZ1KZ", b"\x22AW000001"
_BAM = b"\x20\x0a\x00\x02\xff\xca\xfe\x00", b"\x01\x04\xff\x6e\x00\x03\x05\x64", b"\x02\x00\x01\x01\xff\xff\xff\xff"


def synthetic(path: Path, frames: int) -> None:
    """A log of so many frames, a hundred seconds for each ten thousand."""
    rounds = (
        [(0x7E8, bytes([4, 0x41, 0x0C, n, 0, 0, 0, 0])) for n in range(8)]
        + [(0x7E8, data) for data in _VIN]
        + [(0x0CF00400, bytes([0xF0, 0x7D, 0x7D, 0, n, 0xFF, 0xFF, 0xFF])) for n in range(8)]
        + [(identifier, data) for identifier, data in zip((0x1CECFF00, 0x1CEBFF00, 0x1CEBFF00), _BAM, strict=True)]
    )
    with path.open("w") as stream:
        for number in range(frames):
            identifier, data = rounds[number % len(rounds)]
            name = f"{identifier:08X}" if identifier > 0x7FF else f"{identifier:03X}"
            stream.write(f"({1000 + number * 0.01:.6f}) can0 {name}#{data.hex().upper()}\n")


def samples_of(log: Path, device: str) -> tuple[Iterator[Sample], dict[str, int]]:
    """The samples of a log by a shipped device file, and the counts, complete once they are taken."""
    content = load_device(ROOT / "config" / "devices" / f"{device}.toml")
    recorded = open_recording(content.driver, log, content.settings, content.tags)
    counts: dict[str, int] = {}

    def taken() -> Iterator[Sample]:
        yield from recorded.samples(lambda _, __: None)
        counts.update(recorded.counts())

    return taken(), counts


def drained(log: Path, device: str) -> int:
    samples, _ = samples_of(log, device)
    return sum(1 for _ in samples)


def peak(log: Path) -> float:
    """Peak memory (MB) of Python's allocator while the log is decoded."""
    tracemalloc.start()
    drained(log, "obd2")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return most / 1e6


def speed(folder: Path, frames: int, repeats: int) -> list[Figure]:
    log, short = folder / "log.log", folder / "short.log"
    synthetic(log, frames)
    synthetic(short, frames // 10)
    bare = best(lambda: sum(1 for _ in can.CanutilsLogReader(log)), repeats)
    found = []
    for device, words in (("obd2", "OBD-II"), ("j1939", "J1939")):
        rate = frames / best(lambda device=device: drained(log, device), repeats)
        found.append(Figure(f"log decoded, {words} tags", rate, "frames/s", "python-can's reader alone", frames / bare))
    return [*found, Figure("  peak memory", peak(log), "MB", "a log of a tenth of its size", peak(short))]


def truth(data: Path) -> list[Figure]:
    """Every row of the car's table, every frame of the truck's log."""
    samples, _ = samples_of(data / "tripA164_7E8.candump.log", "obd2")
    told = Counter(
        (sample.tag, round(float(sample.value or 0), 4)) for sample in samples if sample.tag != "EngineRunning"
    )
    with (data / "tripA164_decoded_long.csv").open(newline="") as stream:
        rows = [(row["signal"], float(row["value"])) for row in csv.DictReader(stream)]
    names = {"ENGINE_RPM": "EngineSpeed", "ENGINE_LOAD": "EngineLoad", "ACTUAL_TORQUE_PCT": "EngineTorque",
             "VEHICLE_SPEED": "VehicleSpeed", "INTAKE_MAP": "ManifoldPressure", "COOLANT_TEMP": "CoolantTemperature",
             "THROTTLE": "Throttle", "BARO": "BarometricPressure", "CTRL_MODULE_VOLT": "ModuleVoltage",
             "FUEL_LEVEL": "FuelLevel"}  # fmt: skip
    wanted = Counter((names[name], value) for name, value in rows)
    wrong = (told - wanted).total() + (wanted - told).total()
    truck, counts = samples_of(data / "j1939_186s_allframes.candump.log", "j1939")
    readings = sum(1 for _ in truck)
    accounted = sum(count for name, count in counts.items() if name.startswith("tp_")) + counts["single"]
    return [
        Figure("car: rows compared", float(len(rows)), "", "mismatches", float(wrong)),
        Figure("truck: frames accounted for", float(accounted), "", "frames in the log", float(counts["frames"])),
        Figure(
            "  in whole transport messages",
            float(counts["tp_complete"]),
            "",
            "transport frames",
            float(counts["transport"]),
        ),
        Figure("  readings", float(readings), ""),
    ]


@click.command(help=__doc__)
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of a table.")
@click.option("--quick", is_flag=True, help="A tenth of the frames.")
@click.option("--data", type=click.Path(path_type=Path), default=DATA, help="Folder of the real recordings.")
@click.option("--repeats", type=click.IntRange(1), default=3, show_default=True, help="Repetitions; the best counts.")
def main(as_json: bool, quick: bool, data: Path, repeats: int) -> None:
    frames = FRAMES // 10 if quick else FRAMES
    with tempfile.TemporaryDirectory(prefix="decanter-bench-") as folder:
        figures = speed(Path(folder), frames, repeats)
    give(f"CAN logs, {frames:,} frames", figures + (truth(data) if data.is_dir() else []), as_json=as_json)


if __name__ == "__main__":
    main()
