"""The demonstration's parts: its folder, what it learns and replays, the outage's times, the live table."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from gateway.demo.child import last_words, stop
from gateway.demo.folder import MARKER, WRITTEN, clear, hold_folder
from gateway.demo.live import DemoPhase, demo_table
from gateway.demo.prepare import choose_limit, pace, split, suits, write_device
from gateway.demo.summary import outage
from gateway.settings.devices import load_device
from sim.sha.events import DECANTER
from sim.sha.trace import Trace
from tests.gateway.status_picture import alarm, picture, tag
from tests.gateway.support import MAP, TEMPERATURE


def made(rows: int, name: str = "t", step: float = 1.0, **signals: Any) -> Trace:
    times = 1000.0 + step * np.arange(rows)
    given = {key: np.broadcast_to(np.asarray(value, dtype=float), times.shape).copy() for key, value in signals.items()}
    return Trace(name, times, given or {TEMPERATURE: 20.0 + np.arange(rows) / 10.0})


# ------------------------------------------------------------------ its folder


def test_a_folder_is_held_by_one_demo_at_a_time_and_free_again_after_it(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "demo"
    with hold_folder(folder), pytest.raises(ValueError, match="another demo is running there"), hold_folder(folder):
        pass
    with hold_folder(folder):
        assert (folder / MARKER).is_file()


def test_a_folder_with_somebody_elses_files_is_refused_and_left_alone(tmp_path: Path) -> None:
    mine = tmp_path / "plant.toml"
    mine.write_text("mine", encoding="utf-8")
    with pytest.raises(ValueError, match="holds files that no demo has written"), hold_folder(tmp_path):
        pass
    assert [path.name for path in tmp_path.iterdir()] == ["plant.toml"] and mine.read_text(encoding="utf-8") == "mine"


def test_a_file_in_the_folders_place_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ValueError, match="give --out a folder that this user may write"), hold_folder(path):
            pass


def test_clearing_takes_the_demos_own_files_and_no_other(tmp_path: Path) -> None:
    for name in (*WRITTEN, "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    clear(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_an_error_inside_is_not_taken_for_the_folders(tmp_path: Path) -> None:
    with pytest.raises(BlockingIOError, match="mine"), hold_folder(tmp_path / "d"):
        raise BlockingIOError("mine")


# ------------------------------------------------------------------ what is learned and replayed


def test_the_first_60_percent_are_learned_and_the_longest_rest_is_replayed() -> None:
    before, after = split([made(100)])
    assert [trace.times.size for trace in before] == [60]
    assert after.times.size == 40 and after.times[0] > before[0].times[-1]
    before, after = split([made(50, "a"), made(30, "b"), made(20, "c")])
    assert [(trace.name, trace.times.size) for trace in before] == [("a", 50), ("b", 10)]
    assert (after.name, after.times.size) == ("b", 20)


@pytest.mark.parametrize("traces", [[made(1)], [made(2)], [made(9)], [made(100, step=0.01)]])
def test_too_little_to_learn_and_replay_is_one_sentence(traces: list[Trace]) -> None:
    with pytest.raises(ValueError, match="give a longer trace"):
        split(traces)


def test_a_replay_takes_the_seconds_asked_for_or_less() -> None:
    for rows, step in ((1000, 1.0), (100_000, 1.0), (50, 0.2), (4000, 60.0)):
        replay, speed, period = pace(made(rows, step=step), 20.0)
        assert 1.0 <= speed <= 100.0
        assert np.ptp(replay.times) / speed <= 20.0 + 1e-6
        assert period >= max(0.1, 0.02 * speed - 0.01)


def test_without_a_time_the_whole_trace_is_replayed() -> None:
    for rows in (500, 9000):
        replay, speed, _ = pace(made(rows, step=1.0), None)
        assert replay.times.size == rows
        assert 1.0 <= speed <= 100.0


def test_the_limit_is_the_plants_unless_the_data_are_hotter() -> None:
    cold, hot = made(10, T=[20.0] * 9 + [np.nan]), made(10, T=91.7)
    assert choose_limit([cold], "T", None) == (80.0, "")
    limit, note = choose_limit([cold, hot], "T", None)
    assert limit == pytest.approx(96.3) and "91.7" in note and "--limit" in note
    assert choose_limit([hot], "T", 70.0) == (70.0, "")
    assert choose_limit([made(3, T=np.nan)], "T", None) == (80.0, "")


# ------------------------------------------------------------------ register maps for foreign traces


def test_the_decanters_map_suits_its_own_trace_and_no_other() -> None:
    assert suits(MAP, made(10, TCuscinettiRiduttore=25.0, Assorbimento=[200.0] * 9 + [-999.0]))
    assert not suits(MAP, made(10, MotorTemperature=25.0))
    assert not suits(MAP, made(10, TCuscinettiRiduttore=900.0))


ODD = ['quote"d', "spaces in it", "back\\slash", "ü 𝛼 [°C]", "[red]", "a.b"]


def test_any_name_and_unit_survives_in_the_generated_map(tmp_path: Path) -> None:
    trace = made(10, **{name: np.arange(10) + 0.5 for name in ODD}, Flag=[0.0, 1.0] * 5)
    path = write_device(trace, DECANTER, dict.fromkeys(ODD, 'm"³'), MAP, tmp_path / "device.toml")
    tags = load_device(path).by_name
    assert {name: tags[name].unit for name in ODD} == dict.fromkeys(ODD, 'm"³')
    assert tags["Flag"].bit == 0 and tags['quote"d'].dtype == "float32"
    service = [tag.name for tag in load_device(MAP).tags if tag.name.startswith(("Plc", "Write", "Block"))]
    assert set(service) <= set(tags)
    assert len({tag.address for tag in tags.values()}) == len(tags)


def test_a_signal_that_cannot_be_served_is_named(tmp_path: Path) -> None:
    for signals, words in (({"PlcHeartbeat": 1.5}, "PlcHeartbeat"), ({"Big": 1e39}, "32-bit")):
        with pytest.raises(ValueError, match=words):
            write_device(made(10, **signals), DECANTER, {}, MAP, tmp_path / "device.toml")


# ------------------------------------------------------------------ the outage's times

FAULT = [{"event": "fault began", "time": 1100.0}, {"event": "fault ended", "time": 1300.0}]
SCANS = np.array([1050.0, 1090.0, 1110.0, 1150.0, 1310.0, 1330.0])


def told(good: list[int], happened: list[dict[str, Any]] = FAULT) -> tuple[float | None, float | None]:
    said = outage(happened, SCANS, np.array(good, dtype=bool), 100.0)
    return said["detected_s"], said["recovered_s"]


def test_detection_and_recovery_are_real_seconds_from_the_faults_begin_and_end() -> None:
    assert told([1, 1, 0, 0, 0, 1]) == (pytest.approx(0.1), pytest.approx(0.3))
    assert told([1, 0, 1, 0, 1, 1]) == (pytest.approx(0.5), pytest.approx(0.1))


def test_what_never_came_is_none() -> None:
    assert told([1, 1, 0, 0, 0, 0]) == (pytest.approx(0.1), None)
    assert told([1, 1, 1, 1, 1, 1]) == (None, pytest.approx(0.1))
    assert told([1, 1, 1, 1, 1, 0]) == (None, pytest.approx(0.1))
    assert told([1, 1, 0, 0, 1, 1], FAULT[:1]) == (pytest.approx(0.1), None)
    assert told([1, 1, 0, 0, 1, 1], []) == (None, None)


# ------------------------------------------------------------------ processes and the live table


def test_stopping_insists_when_a_process_does_not_listen() -> None:
    deaf = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('up', flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", deaf], stdout=subprocess.PIPE)
    assert process.stdout is not None and process.stdout.readline() == b"up\n"
    assert stop(process, patience_s=0.2) == -9


def test_the_last_words_of_a_process_are_its_last_line(tmp_path: Path) -> None:
    log = tmp_path / "x.log"
    assert str(log) in last_words(log)
    log.write_bytes(b"first\nplc: the reason \xff\n\n")
    assert last_words(log).startswith("plc: the reason")


STATUS = picture(
    temperature="T [red]",
    values={"T [red]": tag(45.678)},
    alarms={"inputs bad": "normal", "over limit T": "unacknowledged"},
    alarm_summary=[alarm("over limit T")],
)
PLC = {"position": 100.0, "duration": 3780.0, "speed": 99.5, "accepted": 900, "refused": 1, "usable": True}
PLC["block"] = {"temperature_now": 45.6, "sequence": 901}


@pytest.mark.parametrize("width", [80, 140])
def test_the_demo_table_fits_its_terminal_and_shows_names_as_they_are(width: int) -> None:
    console = Console(width=width)
    with console.capture() as captured:
        console.print(demo_table(STATUS, PLC, "T [red]", DemoPhase.RUNNING))
    lines = captured.get().splitlines()
    assert max(map(len, lines)) <= width
    text = " ".join(" ".join(lines).split())
    for words in ("T [red]: running", "45.68 °C GOOD", "in 15 min 46.0 °C (45.0 to 47.0), P(limit) 0.250"):
        assert words in text
    assert "over limit T" in text and "900 blocks accepted, 1 refused" in text
    assert len(lines) <= 18


def test_the_demo_table_shows_a_gateway_that_knows_nothing_yet() -> None:
    status = STATUS | {
        "values": {},
        "prediction": None,
        "forecast": None,
        "recent_events": [],
        "alarms": {},
        "alarm_summary": [],
    }
    console = Console(width=80)
    with console.capture() as captured:
        console.print(demo_table(status, {}, "T", DemoPhase.OUTAGE))
    assert "nan" not in captured.get() and "None" not in captured.get()
