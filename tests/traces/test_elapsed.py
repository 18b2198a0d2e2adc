"""Elapsed times: their unit is told by the file, concluded and said, or asked; none is believed in silence."""

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from sim.lab.recordings import load_map
from tests.traces.exports import BEGIN, STEP, recording, wide
from tests.traces.test_dialects import asked, is_the_plant, mapped

SIZES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0, "h": 3600.0}


def counted(unit: str, *, step: float = STEP) -> Callable[[datetime], str]:
    """A clock that counts in a unit from the beginning of the plant's rows, `step` s apart."""
    return lambda t: f"{(t - BEGIN).total_seconds() / STEP * step / SIZES[unit]:.9g}"


@pytest.mark.parametrize("name", ["t", "Time"])
@pytest.mark.parametrize(("unit", "step"), [("ms", 0.1), ("ms", 1.0), ("min", 60.0)])
def test_a_unit_that_nothing_says_is_asked(name: str, unit: str, step: float, tmp_path: Path) -> None:
    """0, 100, 200 ... were seconds in silence, and with them 0, 1, 2 ... of minutes.

    In a tenth of the time it warms by a tenth.
    """
    plant = recording()
    slower = replace(plant, heat=21.5 + (plant.heat - 21.5) * min(step / STEP, 1.0))
    export = wide(tmp_path / "e.csv", header=f"{name},Bearing temperature,Motor current,Running", of=slower,
                  clock=counted(unit, step=step))  # fmt: skip
    question = asked(export, tmp_path / "m.toml")
    assert f"the times in {name!r} say no unit" in question and f"--unit {name}={unit}" in question
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--unit", f"{name}={unit}")
    assert trace.times[1] - trace.times[0] == pytest.approx(step)


@pytest.mark.parametrize("name", ["t", "Time"])
def test_seconds_in_which_a_machine_would_go_so_are_taken_and_said(name: str, tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", header=f"{name},Bearing temperature,Motor current,Running", clock=counted("s"))
    (trace,), _, drafted = mapped(export, tmp_path / "m.toml")
    (said,) = (sentence for sentence in drafted["report"] if "in seconds" in sentence)
    assert f"{name!r} is read in seconds: nothing says its unit" in said and f"--unit '{name}=min'" in said
    assert 'formats = ["seconds"]    # nothing says its unit' in (tmp_path / "m.toml").read_text(encoding="utf-8")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("unit", ["ms", "us"])
def test_the_guess_is_the_unit_in_which_a_temperature_goes_as_one_of_a_machine(unit: str, tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", clock=counted(unit))
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--yes")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("name", "unit"),
    [("Time (ms)", "ms"), ("t_ms", "ms"), ("Zeit in Sekunden", "s"), ("Tempo [minuti]", "min"), ("Time [hours]", "h")],
)
def test_the_name_says_it(name: str, unit: str, tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", header=f"{name},Bearing temperature,Motor current,Running", clock=counted(unit))
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_names_of_several_units_say_none(tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", header="Time h:min,Bearing temperature,Motor current,Running", clock=counted("s"))
    assert "--unit 'Time h:min=s'" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("line", "unit"),
    [("Sampling interval: 10 s", "ms"), ("Sample rate;0.1 Hz", "ms"), ("Abtastintervall [ms]: 10000", "s"),
     ("dt = 10s", "us"), ("Sample Period:,10000 ms", "s"), ("Sample interval: 10000000 µs", "ms"),
     ("Scan rate: 6 scans/minute", "ms"), ("Sampling_interval_s: 10", "ms"),
     ("Intervallo di campionamento: 10 s", "ms"), ("Interval: 10 s", "ms")],
)  # fmt: skip
def test_what_stands_above_the_table_says_it(line: str, unit: str, tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", clock=counted(unit))
    export.write_text(f"{line}\nRecorder 7\n{export.read_text(encoding='utf-8')}", encoding="utf-8")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_a_row_of_units_says_it(tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", clock=counted("ms"))
    name, rows = export.read_text(encoding="utf-8").split("\n", 1)
    export.write_text(f"{name}\nms,degC,A,\n{rows}", encoding="utf-8")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_another_clock_of_the_file_says_it(tmp_path: Path) -> None:
    """The column that is called a time counts, and the one beside it is the wall's."""
    name = "Time,Written,Bearing temperature,Motor current,Running"
    export = wide(tmp_path / "e.csv", header=name, clock=lambda t: f"{counted('ms')(t)},{t + timedelta(days=3)}")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


def test_numbers_of_rows_are_no_times(tmp_path: Path) -> None:
    """The lines above say how often one is written, and the column counts them."""
    export = wide(tmp_path / "e.csv", clock=lambda t: f"{(t - BEGIN).total_seconds() / STEP:.0f}")
    export.write_text(f"Sample rate: 0.1 Hz\n\n{export.read_text(encoding='utf-8')}", encoding="utf-8")
    assert "'Time' counts rows, and the lines above say one every 10 s" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize("unit", ["d", "min", "h"])
def test_every_unit_can_be_answered(unit: str, tmp_path: Path) -> None:
    size = SIZES.get(unit, 86400.0)
    export = wide(tmp_path / "e.csv", clock=lambda t: f"{(t - BEGIN).total_seconds() / size:.12g}")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--unit", f"Time={unit}")
    is_the_plant(trace, tmp_path / "m.toml", recording())


@pytest.mark.parametrize(
    "line",
    ["Calibration interval: 10 min", "Report interval: 10 min", "Sampling duration: 10 min", "Sample rate: 1,000 Hz",
     "Sample interval error: 10 min", "Sample interval: 1,000 ms", "Message interval: 10 min"],
)  # fmt: skip
def test_other_intervals_and_thousands_are_no_evidence(line: str, tmp_path: Path) -> None:
    """Each would make the times what they are not: ten minutes a row of ten seconds, or a hertz of a thousand."""
    every = 1.0 if "1,000" in line else STEP
    slower = replace(recording(), heat=21.5 + (recording().heat - 21.5) * every / STEP)
    export = wide(tmp_path / "e.csv", of=slower, clock=counted("s", step=every))
    export.write_text(f"{line}\n{export.read_text(encoding='utf-8')}", encoding="utf-8")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml", "--yes")
    assert trace.times[1] - trace.times[0] == pytest.approx(every)


@pytest.mark.parametrize("name", ["Time of day", "Std time"])
def test_words_that_are_units_elsewhere_are_none(name: str, tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", header=f"{name},Bearing temperature,Motor current,Running", clock=counted("s"))
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize("name", ["Time (secs)", "timeSec", "Zeit (Sek)"])
def test_further_words_of_seconds_are_seconds_however_slowly_it_goes(name: str, tmp_path: Path) -> None:
    plant = recording()
    slow = replace(plant, heat=21.5 + (plant.heat - 21.5) / 1000.0)
    export = tmp_path / "e.csv"
    wide(export, header=f"{name},Bearing temperature,Motor current,Running", of=slow, clock=counted("s"))
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times[1] - trace.times[0] == pytest.approx(STEP)


@pytest.mark.parametrize("name", ["Zeit (Std)", "Zeit in Std", "Time [hour]", "Time (hrs)"])
def test_a_unit_in_brackets_is_one(name: str, tmp_path: Path) -> None:
    export = wide(tmp_path / "e.csv", header=f"{name},Bearing temperature,Motor current,Running",
                  clock=lambda t: f"{(t - BEGIN).total_seconds() / 3600.0:.12g}")  # fmt: skip
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("step", "per_hour", "unit"),
    [(10.0, 1.0, "s"), (60.0, 0.5, "s"), (600.0, 0.3, "s"), (100.0, 0.05, "ms"), (1000.0, 0.02, "ms"),
     (1.0, 9000.0, "min")],
)  # fmt: skip
def test_the_guess_is_seconds_where_a_temperature_drifts_as_a_room_does(
    step: float, per_hour: float, unit: str, tmp_path: Path
) -> None:
    """`per_hour` degC if the counts, `step` apart, are seconds."""
    lines = [f"{at * step:g},{20 + per_hour * at * step / 3600.0:.6f},120,1" for at in range(240)]
    export = tmp_path / "e.csv"
    export.write_text("\n".join(["Time,Bearing temperature,Motor current,Running", *lines]), encoding="utf-8")
    question = asked(export, tmp_path / "m.toml")
    assert f"most likely 'Time={unit}', which --yes takes" in question
    assert len(question) < 600 and all(f"--unit Time={one}" in question for one in ("s", "ms", "min", "h"))


def test_sessions_that_begin_anew_beside_another_clock_count_as_it_does(tmp_path: Path) -> None:
    """From the first row to the last the other goes sixty times as far."""
    name = "Time,Written,Bearing temperature,Motor current,Running"

    def clock(t: datetime) -> str:
        row = round((t - BEGIN).total_seconds() / STEP)
        return f"{row % 5 * STEP:g},{t + timedelta(days=3)}"

    export = wide(tmp_path / "e.csv", header=name, clock=clock)
    out = tmp_path / "m.toml"
    done = CliRunner().invoke(main, ["trace", "map", str(export), "-o", str(out), "--yes",
                                     "--clock-back", "split"])  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert load_map(out).clock.formats == ("seconds",)
