"""An emulated PLC that nobody knows yet, and what a commissioning engineer is given: an I/O list and an HMI.

Words are swapped (CDAB); every address is one higher than its I/O list says; one register in the middle is forbidden;
a request may have 16 registers; one client is served at a time. `python -m benchmarks.unknown_plc config/examples`
writes the files of such a PLC that docs/commissioning.md uses.
"""

import csv
import sys
import time
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit

from gateway.commission.files.device_file import fields_that_fit, set_block, set_device
from sim.artefacts.model_json import model_text
from sim.lab.recordings.trace_file import write_trace
from sim.sha.trace import Trace
from tests.rig.pair import CYCLE_S, MAP, TEMPERATURE, Plc, known_model, plc_process, restless_trace

LIMIT = 16
HOLE = 105
"""PDU address of the forbidden register; the I/O list calls it a spare."""
BLOCK = 401
SETTLED_S = 0.2
"""After so long the PLC's program and the HMI show the new state."""
LATER = "TAmbiente"
"""A signal that the HMI shows and the I/O list has forgotten."""
SECONDS = 600.0
TITLES = (("Elenco I/O - PLC decanter linea 2", "", "", "", "", "", "", "", ""), ("rev. C", *[""] * 8))
HEADER = ("Nome tag", "Descrizione", "Indirizzo", "Tipo dato", "Fattore", "Unità di misura", "Min", "Max", "Sentinella")
_TYPES = {"bool": "BOOL", "uint16": "WORD", "int16": "INT", "float32": "REAL"}


@dataclass(frozen=True, slots=True)
class Unknown:
    """The folder with what the engineer has: `list`, `model`; and what nobody but the PLC has: `map`, `trace`."""

    folder: Path

    @property
    def map(self) -> Path:
        return self.folder / "plc.toml"

    @property
    def trace(self) -> Path:
        return self.folder / "trace.csv"

    @property
    def list(self) -> Path:
        return self.folder / "io_list.csv"

    @property
    def recording(self) -> Path:
        return self.folder / "plc.jsonl"


def make_unknown(folder: Path) -> Unknown:
    """Write the PLC's own files, and those that the engineer is given."""
    unknown = Unknown(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _write_map(unknown.map)
    write_trace(restless_trace(SECONDS), unknown.trace)
    _write_list(unknown.map, unknown.list)
    (folder / "model.json").write_text(model_text(known_model()), encoding="utf-8")
    return unknown


SEEN_AT = (12, 44)
"""Seconds of the examples' trace at which somebody writes down what the HMI shows: two states of the plant."""
SWITCHES = (
    "MarciaDecanter",
    "MarciaPmpFango",
    "CicloAttivo",
    "AllarmeVibrazioni",
    "AllarmeTCuscinetti",
    "PresenzaAllarme",
)


_PLANT_SH = """\
# bash plant.sh PORT '{"command": ...}': one command to the control port of the emulated PLC, and its answer.
exec 3<>"/dev/tcp/127.0.0.1/$1"
echo "$2" >&3
head -n 1 <&3
sleep 0.2   # until the PLC's program and the HMI show it
"""


def write_examples(folder: Path) -> None:
    """The files of docs/commissioning.md: the PLC's own map, trace and fault; the engineer's list and HMI notes."""
    folder.mkdir(parents=True, exist_ok=True)
    _write_map(folder / "unknown_plc.toml")
    _write_list(folder / "unknown_plc.toml", folder / "io_list.csv")
    moving = restless_trace(120.0, step=1.0)
    # Hundredths in the temperatures: of round numbers a float's second word is 0 at every reading, and proves nothing.
    odd = {name: moving.signals[name] * 1.01 for name in (TEMPERATURE, "TCuscinettiAlimentazione")}
    signals = {name: values.round(2) for name, values in (moving.signals | odd).items()}
    signals |= dict.fromkeys(SWITCHES, (moving.times < SEEN_AT[1]).astype(float))
    trace = Trace("unknown", moving.times, signals, origin="made for docs/commissioning.md", synthetic=True)
    write_trace(trace, folder / "unknown_plc.csv")
    fault = f'[[fault]]\nkind = "illegal_register"\nregisters = ["holding:{HOLE}"]\n'
    (folder / "unknown_plc_faults.toml").write_text(fault, encoding="utf-8")
    (folder / "plant.sh").write_text(_PLANT_SH, encoding="utf-8")
    for number, second in enumerate(SEEN_AT, start=1):
        shown = {name: float(values[second]) for name, values in signals.items()}
        rows = [(name, f"{shown[name]:.0f}" if name in SWITCHES else _display(shown[name])) for name in shown]
        with (folder / f"hmi{number}.csv").open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, delimiter=";").writerows((("Tag", "Valore HMI"), *rows))


def start(unknown: Unknown) -> Plc:
    """The PLC as a process, its replay held, with the forbidden register; the caller ends it."""
    options = ["--device", unknown.map, "--trace", unknown.trace, "--record", unknown.recording, "--cycle", CYCLE_S]
    limits = ["--max-registers", LIMIT, "--max-clients", 1, "--loop", "--stdin"]
    plc = plc_process(*options, *limits)
    plc.order("pause")
    plc.order("fault", fault={"kind": "illegal_register", "registers": [f"holding:{HOLE}"]})
    return plc


def _moved(address: str) -> str:
    """Where the shipped map's register lies in this PLC: one higher, and two from the forbidden one on."""
    table, _, number = address.partition(":")
    return f"{table}:{int(number) + 1 + (int(number) + 1 >= HOLE)}"


def _write_map(path: Path) -> None:
    # It takes one block, of whatever is predicted: without the tags of the further one, and without its place.
    tags, _, rest = MAP.read_text(encoding="utf-8").partition("# What it thinks of the blocks of the feed bearing")
    _, title, block = rest.partition("# Gateway to PLC")
    document: Any = tomlkit.parse(tags + title + block.partition("# The same words once more")[0].rstrip() + "\n")
    del document["writeback"]["temperature"]
    for tag in document["tags"]:
        tag["address"] = _moved(str(tag["address"]))
    set_device(document, {"max_registers": LIMIT})
    set_block(document, {"address": f"holding:{BLOCK}"}, fields_that_fit(LIMIT), MAP)
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def _write_list(device: Path, path: Path) -> None:
    """The I/O list: Italian, with semicolons and decimal commas, one address too low, no word about the word order."""
    tags = tomllib.loads(device.read_text(encoding="utf-8"))["tags"]
    with path.open("w", encoding="cp1252", newline="") as stream:
        writer = csv.writer(stream, delimiter=";", lineterminator="\r\n")
        writer.writerows((*TITLES, HEADER))
        for tag in tags:
            if tag["name"] != LATER:
                writer.writerow(_row(tag))
            if tag["name"] == "Differenziale":
                writer.writerow(("Riserva", "non usato", _reference(f"holding:{HOLE}"), "WORD", "", "", "", "", ""))


def _row(tag: Mapping[str, Any]) -> Sequence[str]:
    bit = f".{tag['bit']}" if "bit" in tag else ""
    unit = "°C" if tag.get("unit") == "degC" else str(tag.get("unit", ""))
    numbers = [_comma(tag.get(key)) for key in ("low", "high", "sentinel")]
    kind = _TYPES[tag.get("dtype", "uint16")]
    return (tag["name"], "", _reference(tag["address"]) + bit, kind, _comma(tag.get("scale")), unit, *numbers)


def _reference(address: str) -> str:
    """The number that the list prints: one less than it is."""
    return f"4{int(address.partition(':')[2]):04d}"


def _comma(number: float | None) -> str:
    return "" if number is None else f"{number:g}".replace(".", ",")


# ---------------------------------------------------------------- the person at the HMI


@dataclass(frozen=True, slots=True)
class Person:
    """Somebody at the HMI: reads what it shows, brings the plant into another state, answers questions."""

    plc: Plc

    def reads(self, name: str) -> str:
        """What the HMI shows for a tag, with a decimal comma."""
        return _display(self.plc.order("values")["values"][name])

    def writes_down(self, path: Path, names: Sequence[str]) -> None:
        """A list of what the HMI shows now."""
        values = self.plc.order("values")["values"]
        with path.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, delimiter=";")
            writer.writerow(("Tag", "Valore HMI"))
            writer.writerows((name, _display(values[name])) for name in names)

    def moves_plant(self, position: float, states: Mapping[str, bool]) -> None:
        """Bring the plant to another place of its trace, with these switches."""
        self.plc.order("seek", position=position)
        for name, on in states.items():
            self.plc.order("force", tag=name, value=on)
        time.sleep(SETTLED_S)

    def answers(self, question: str) -> str:
        """`y` if what is asked is so; what is asked to be done is done first."""
        status = self.plc.order("status")
        if "bit " in question:
            bit = int(question.partition("bit ")[2].partition(",")[0])
            return "y" if status["block"]["alarms"] == 1 << bit else "n"
        if "no alarm" in question:
            return "y" if status["block"]["alarms"] == 0 else "n"
        if "permit" in question:
            self.plc.order("permit", on="give" in question.lower())
            return "y"
        return "n"


def _display(value: Any) -> str:
    if isinstance(value, bool):
        return "1" if value else "0"
    return f"{value:.1f}".replace(".", ",") if isinstance(value, float) else str(value)


if __name__ == "__main__":
    write_examples(Path(sys.argv[1]))
