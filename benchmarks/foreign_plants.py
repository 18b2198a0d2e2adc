"""Two plants of other makes, for `benchmarks.first_hour`: their PLCs, their I/O lists, their SCADA's exports.

No name of theirs is the decanter's. A pump speaks English: float32 in input registers, low word first, a discrete
input; a fan speaks German: scaled integers in holding registers, an export with semicolons, decimal commas, the newest
row first, EIN and AUS for two switches, and a cell that says Störung.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from sim.lab.recordings.trace_file import write_trace
from sim.sha.trace import Array, Trace

DAY_S = 86_400.0
PERIOD_S = 30.0
BEARINGS = ((1.9, 1500.0), (1.3, 2100.0))
"""degC that a kW warms each bearing by, and the s in which it does."""
LOADS_KW = (12.0, 18.0, 25.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ForeignPlant:
    """A machine with a switch, a load and two bearings, and what its people call these.

    `tags` are the PLC's names of running, load, the two bearings and, where there is one, a second switch; `rows` those
    of the I/O list, `device` the file that the software PLC is started with, `headers` the export's, in the order of
    the tags.
    """

    tags: Sequence[str]
    rows: Sequence[str]
    device: str
    headers: Sequence[str]
    time_header: str
    time_format: str
    words: tuple[str, str]
    separator: str = ","
    decimal: str = "."
    newest_first: bool = False
    fault_word: str = ""
    options: str = ""

    @property
    def temperature(self) -> str:
        """The tag that is predicted."""
        return self.tags[2]

    def write(self, folder: Path) -> None:
        """The list, the PLC, the export of two days, and the day that the PLC replays."""
        (folder / "io.csv").write_text("\n".join(self.rows) + "\n", encoding="utf-8")
        (folder / "emulated.toml").write_text(self.device, encoding="utf-8")
        self._write_export(folder / "export.csv")
        replayed = recording(1, seed=9)
        columns = {tag: replayed[name] for tag, name in zip(self.tags, replayed, strict=False)}
        times = np.arange(next(iter(columns.values())).size) * PERIOD_S
        late = times >= 6 * 3600.0
        columns = {tag: column[late] for tag, column in columns.items()}
        write_trace(
            Trace("plant", times[late] - times[late][0], columns, origin="of another day", synthetic=True),
            folder / "plant.csv",
        )

    def _write_export(self, path: Path) -> None:
        told = list(recording(2, seed=1).values())[: len(self.tags)]
        begin = datetime(2026, 3, 1, tzinfo=UTC)
        rows = []
        for place, values in enumerate(zip(*told, strict=True)):
            cells = [
                self.words[0 if value else 1] if number in (0, 4) else f"{value:.1f}".replace(".", self.decimal)
                for number, value in enumerate(values)
            ]
            rows.append([(begin + timedelta(seconds=place * PERIOD_S)).strftime(self.time_format), *cells])
        if self.fault_word:
            rows[len(rows) // 3][3] = self.fault_word
        with path.open("w", encoding="utf-8", newline="") as stream:
            writer = csv.writer(stream, delimiter=self.separator)
            writer.writerow((self.time_header, *self.headers))
            writer.writerows(rows[::-1] if self.newest_first else rows)


def recording(days: int, *, seed: int) -> dict[str, Array]:
    """running, load (kW), two bearings (degC) and an oil pump that runs with the machine, every PERIOD_S."""
    rng = np.random.default_rng(seed)
    times = np.arange(0.0, days * DAY_S, PERIOD_S)
    running, load = np.zeros(times.size), np.zeros(times.size)
    for day in range(days):
        begin = day * DAY_S + 6 * 3600.0 + rng.uniform(0.0, 1800.0)
        for _ in range(5):
            long = rng.uniform(2400.0, 7200.0)
            on = (times >= begin) & (times < begin + long)
            running[on], load[on] = 1.0, rng.choice(LOADS_KW)
            begin += long + rng.uniform(1200.0, 4800.0)
    load = np.where(running > 0, load + rng.normal(0.0, 0.3, times.size), 0.0).round(1)
    hall = 20.0 + 3.0 * np.sin(2 * np.pi * (times / DAY_S - 0.3))
    bearings = {}
    for name, (warmth, slowness) in zip(("first", "second"), BEARINGS, strict=True):
        now, warm = float(hall[0]), np.empty(times.size)
        for place in range(times.size):
            warm[place] = now
            now += PERIOD_S / slowness * (hall[place] + warmth * load[place] - now) + rng.normal(0.0, 0.02)
        bearings[name] = (warm + rng.normal(0.0, 0.08, times.size)).round(1)
    return {"running": running, "load": load, **bearings, "oil pump": running}


PUMP = ForeignPlant(
    tags=("PumpRun", "MotorPower", "DE_Temp", "NDE_Temp"),
    rows=(
        "Tag,Address,Type,Unit",
        "PumpRun,10004,BOOL,",
        "MotorPower,30101,REAL,kW",
        "DE_Temp,30103,REAL,degC",
        "NDE_Temp,30105,REAL,degC",
    ),
    device="""[device]
name = "pump"
driver = "modbus"
unit = 1
[[tags]]
name = "PumpRun"
address = "discrete:3"
dtype = "bool"
[[tags]]
name = "MotorPower"
address = "input:100"
dtype = "float32"
order = "CDAB"
[[tags]]
name = "DE_Temp"
address = "input:102"
dtype = "float32"
order = "CDAB"
[[tags]]
name = "NDE_Temp"
address = "input:104"
dtype = "float32"
order = "CDAB"
""",
    headers=(
        "Pump 3 running",
        "Motor power (kW)",
        "Bearing DE temperature (°C)",
        "Bearing NDE temperature (°C)",
    ),
    time_header="Time",
    time_format="%Y-%m-%d %H:%M:%S",
    words=("RUNNING", "STOPPED"),
    options="--order CDAB",
)
FAN = ForeignPlant(
    tags=("Lüfter_Betrieb", "Motorleistung", "T_Lager_AS", "T_Lager_BS", "Ölpumpe_Ein"),
    rows=(
        "Bezeichnung;Adresse;Datentyp;Faktor;Einheit",
        "Lüfter_Betrieb;10011;BOOL;;",
        "Ölpumpe_Ein;10012;BOOL;;",
        "Motorleistung;40201;INT;0,1;kW",
        "T_Lager_AS;40202;INT;0,1;°C",
        "T_Lager_BS;40203;INT;0,1;°C",
    ),
    device="""[device]
name = "fan"
driver = "modbus"
unit = 1
[[tags]]
name = "Lüfter_Betrieb"
address = "discrete:10"
dtype = "bool"
[[tags]]
name = "Ölpumpe_Ein"
address = "discrete:11"
dtype = "bool"
[[tags]]
name = "Motorleistung"
address = "holding:200"
dtype = "int16"
scale = 0.1
[[tags]]
name = "T_Lager_AS"
address = "holding:201"
dtype = "int16"
scale = 0.1
[[tags]]
name = "T_Lager_BS"
address = "holding:202"
dtype = "int16"
scale = 0.1
""",
    headers=(
        "Lüfter in Betrieb",
        "Leistung Motor [kW]",
        "Lagertemperatur AS [°C]",
        "Lagertemperatur BS [°C]",
        "Ölpumpe Ein/Aus",
    ),
    time_header="Zeitstempel",
    time_format="%d.%m.%Y %H:%M:%S",
    words=("EIN", "AUS"),
    separator=";",
    decimal=",",
    newest_first=True,
    fault_word="Störung",
)
FOREIGN: Mapping[str, ForeignPlant] = {"pump": PUMP, "fan": FAN}
"""A plant by its name."""
