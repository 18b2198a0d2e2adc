"""Logs as other programs write them: every frame with its time, or the log is said to be cut or to have none."""

from pathlib import Path

import can
import pytest

from drivers.can import CanFrame
from drivers.vehicle.log import Log, open_log

SHARED = Path(__file__).parents[3] / "shared" / "cases" / "devices"
DATA = bytes.fromhex("F07D7D6813F0F07D")
PRINTED = "can0  0CF00400   [8]  F0 7D 7D 68 13 F0 F0 7D"
GVRET = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
CANEDGE = "TimestampEpoch;BusChannel;ID;IDE;DLC;DataLength;Dir;EDL;BRS;DataBytes\n"
BUSMASTER = "***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***{base}***\n***{mode} MODE***\n"


def read(folder: Path, name: str, text: str) -> tuple[list[CanFrame], Log]:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    log = open_log(path)
    return list(log.frames()), log


@pytest.mark.parametrize(
    ("name", "text", "times"),
    [
        ("a.log", f" (1772359200.000000)  {PRINTED}\n (1772359200.100000)  {PRINTED}\n", [1772359200.0, 1772359200.1]),
        ("b.log", f" (2026-03-01 10:00:00.5)  {PRINTED}\n", [1772359200.5]),
        ("c.log", f" (1772359200.000000)  {PRINTED.replace('can0', 'can0  RX - -')}  '.}}}}h..'\n", [1772359200.0]),
        ("d.log", f" (000.000000)  {PRINTED}\n (000.250000)  {PRINTED}\n", [0.0, 0.25]),
        ("e.csv", GVRET + "1500000,0CF00400,true,Rx,0,8,F0,7D,7D,68,13,F0,F0,7D,\n", [1.5]),
        ("i.csv", GVRET.replace("Dir,", "") + "1500000,0CF00400,true,0,8,F0,7D,7D,68,13,F0,F0,7D,\n", [1.5]),
        ("f.csv", CANEDGE + "1772359200.5;1;0CF00400;1;8;8;0;0;0;F07D7D6813F0F07D\n", [1772359200.5]),
        (
            "g.log",
            BUSMASTER.format(base="HEX", mode="SYSTEM")
            + "00:00:01:5000 Rx 1 0x0CF00400 x 8 F0 7D 7D 68 13 F0 F0 7D \n***[STOP LOGGING SESSION]***\n",
            [1.5],
        ),
        (
            "h.log",
            BUSMASTER.format(base="DEC", mode="RELATIVE")
            + "0:0:1:5000 Rx 1 217056256 x 8 240 125 125 104 19 240 240 125\n" * 2,
            [1.5, 3.0],
        ),
        (  # as SavvyCAN writes it: no 0x, and midnight passes
            "j.log",
            BUSMASTER.format(base="HEX", mode="SYSTEM")
            + "".join(f"{time}:992 Rx 0 0CF00400 x 8 F0 7D 7D 68 13 F0 F0 7D \n" for time in ("23:59:59", "00:00:00")),
            [86399.992, 86400.992],
        ),
    ],
)
def test_what_another_program_writes_gives_its_frames(name: str, text: str, times: list[float], tmp_path: Path) -> None:
    frames, log = read(tmp_path, name, text)
    assert [frame.time for frame in frames] == pytest.approx(times), log.summary()
    assert all((frame.id, frame.extended, frame.data) == (0x0CF00400, True, DATA) for frame in frames)
    assert not log.problem


def busmaster_times(folder: Path, mode: str, *lines: str) -> tuple[list[float], Log]:
    """What is read of a log with these headers (***) and times of frames."""
    rows = [line if line.startswith("***") else f"{line} Rx 1 0CF00400 x 8 F0 7D 7D 68 13 F0 F0 7D" for line in lines]
    frames, log = read(folder, "a.log", BUSMASTER.format(base="HEX", mode=mode) + "\n".join(rows) + "\n")
    return [frame.time for frame in frames], log


STARTS = "***[START LOGGING SESSION]***", "***START DATE AND TIME {}***"


@pytest.mark.parametrize(
    ("mode", "lines", "times"),
    [
        (  # two buses around midnight, out of order by less than a millisecond
            "SYSTEM",
            ("23:59:59:9990", "00:00:00:0010", "23:59:59:9995", "00:00:00:0020"),
            [86399.999, 86400.001, 86399.9995, 86400.002],
        ),
        ("SYSTEM", ("08:00:00:0000", "21:00:00:0000", "06:30:00:0000"), [28800.0, 75600.0, 109800.0]),  # it stood still
        ("SYSTEM", ("03:00:00:0000", "02:00:00:0000"), [10800.0, 7200.0]),  # winter time
        ("ABSOLUTE", ("13:00:00:0000", "00:00:01:0000"), [46800.0, 1.0]),
    ],
)
def test_a_time_of_day_is_of_the_day_that_its_neighbours_tell(
    mode: str, lines: tuple[str, ...], times: list[float], tmp_path: Path
) -> None:
    found, log = busmaster_times(tmp_path, mode, *lines)
    assert found == pytest.approx(times, abs=1e-6) and not log.counts["refused"]


@pytest.mark.parametrize(
    "refused", ["23:00:00:0000 Rx 1 123 s 8 01 02", "23:00:00:0000 Rx 1 FFFF s 1 01", "23:00:00:0000 Rx 1 123 s 1 +1"]
)
def test_a_line_that_is_no_frame_makes_no_midnight(refused: str, tmp_path: Path) -> None:
    text = BUSMASTER.format(base="HEX", mode="SYSTEM") + f"{refused}\n00:00:01:0000 Rx 1 123 s 1 01\n"
    frames, log = read(tmp_path, "a.log", text)
    assert [frame.time for frame in frames] == [1.0] and log.counts["refused"] == 1


@pytest.mark.parametrize(
    ("mode", "times"),
    [
        ("SYSTEM", [72000.0, 72001.0, 86400.0 + 43200.0, 86400.0 + 43201.0]),
        ("ABSOLUTE", [1.0, 2.0, 16 * 3600.0 + 1.0, 16 * 3600.0 + 2.0]),
        ("RELATIVE", [1.0, 3.0, 16 * 3600.0 + 1.0, 16 * 3600.0 + 3.0]),
    ],
)
def test_sessions_of_one_file_keep_their_distance(mode: str, times: list[float], tmp_path: Path) -> None:
    first, second = ("20:00:00:0000", "20:00:01:0000"), ("12:00:00:0000", "12:00:01:0000")
    if mode != "SYSTEM":
        first = second = "00:00:01:0000", "00:00:02:0000"
    began, at = STARTS
    lines = began, at.format("31:8:2014 20:0:0:0"), *first, began, at.format("1:9:2014 12:0:0:0"), *second
    found, log = busmaster_times(tmp_path, mode, *lines)
    assert found == pytest.approx(times) and not log.problem


@pytest.mark.parametrize(
    ("mode", "sessions", "times"),
    [
        (  # it begins just before midnight, and its first frame is of the next day
            "SYSTEM",
            (("12:0:0:0", "12:00:00:0000"), ("23:59:59:900", "00:00:00:1000", "00:00:01:0000")),
            [43200.0, 86400.1, 86401.0],
        ),
        ("SYSTEM", (("23:59:59:900", "00:00:00:1000", "23:59:59:9995"),), [86400.1, 86399.9995]),
        ("SYSTEM", (("0:30:0:0", "23:30:00:0000", "23:31:00:0000"),), [84600.0, 84660.0]),  # none of the day before
        ("SYSTEM", (("20:0:0:950", "20:00:00:9000"),), [72000.9]),
        ("RELATIVE", (("12:0:0:950", "00:00:00:0000"), ("12:0:2:0", "00:00:00:0000")), [0.0, 1.05]),
        ("ABSOLUTE", (("12:0:0:950", "00:00:01:0000"), ("12:0:2:5", "00:00:01:0000")), [1.0, 2.055]),
    ],
)
def test_a_session_counts_from_the_moment_at_which_it_began(
    mode: str, sessions: tuple[tuple[str, ...], ...], times: list[float], tmp_path: Path
) -> None:
    began, at = STARTS
    lines = [line for start, *frames in sessions for line in (began, at.format(f"1:9:2014 {start}"), *frames)]
    found, log = busmaster_times(tmp_path, mode, *lines)
    assert found == pytest.approx(times, abs=1e-6) and not log.problem


def test_a_line_with_a_size_of_thousands_of_digits_is_no_frame(tmp_path: Path) -> None:
    rows = f"00:00:00:0000 Rx 1 123 x {'8' * 5000} F0\n00:00:01:0000 Rx 1 123 s 1 01\n"
    frames, log = read(tmp_path, "a.log", BUSMASTER.format(base="HEX", mode="SYSTEM") + rows)
    assert [frame.time for frame in frames] == [1.0] and log.counts["refused"] == 1


@pytest.mark.parametrize("said", [(False, True), (True, False), (False, False)], ids=str)
def test_a_second_session_of_which_nobody_knows_when_it_was_is_refused(said: tuple[bool, bool], tmp_path: Path) -> None:
    began, at = STARTS
    first, second = ((at.format(f"{day}:8:2014 1:0:0:0"),) * known for day, known in zip((8, 9), said, strict=True))
    found, log = busmaster_times(tmp_path, "SYSTEM", began, *first, "01:00:00:0000", began, *second, "02:00:00:0000")
    assert found == [3600.0] and log.counts["refused"] == 1 and "session 2" in log.problem


def test_a_line_of_fewer_bytes_than_it_says_is_no_frame(tmp_path: Path) -> None:
    text = BUSMASTER.format(base="HEX", mode="SYSTEM") + "00:00:01:5000 Rx 1 0x0CF00400 x 8 F0 7D 7D\n"
    frames, log = read(tmp_path, "cut.log", text)
    assert not frames and log.counts["refused"] == 1


def test_kinds_of_printed_frames_are_told_apart(tmp_path: Path) -> None:
    rows = ("can0  123   [0]  remote request", "can0  123  [12]  " + "00 " * 12, "can0  123   [3]  01 02 03")
    frames, log = read(tmp_path, "a.log", "".join(f" (1.000000)  {row}\n" for row in rows))
    assert [(frame.id, len(frame.data), frame.fd) for frame in frames] == [(0x123, 12, True), (0x123, 3, False)]
    assert log.counts["remote_frames"] == 1 and not log.counts["refused"]


@pytest.mark.parametrize(
    "text", [f"  {PRINTED}\n" * 2, f" (000.100000)  {PRINTED}\n (000.000000)  {PRINTED}\n (000.099000)  {PRINTED}\n"]
)
def test_a_log_without_times_of_its_own_says_what_to_do(text: str, tmp_path: Path) -> None:
    frames, log = read(tmp_path, "a.log", text)
    assert not frames and log.counts["broken"] == 1 and "candump -L" in log.problem


def test_relative_times_of_an_asc_are_added_up_over_every_event(tmp_path: Path) -> None:
    text = "date Sun Mar 1 10:00:00 am 2026\nbase hex  timestamps relative\nno internal events logged\n"
    row = "   {} 1  CF00400x       Rx   d 8 F0 7D 7D 68 13 F0 F0 7D\n"
    text += row.format("0.000000") + row.format("0.100000") + "   0.050000 1  ErrorFrame\n" + row.format("0.100000")
    frames, log = read(tmp_path, "a.asc", text)
    assert [frame.time for frame in frames] == pytest.approx([0.0, 0.1, 0.25])
    assert log.counts["error_frames"] == 1
    absolute, _ = read(tmp_path, "b.asc", text.replace("relative", "absolute"))
    assert [frame.time for frame in absolute] == pytest.approx([0.0, 0.1, 0.1])


def test_a_blf_that_is_shorter_than_its_header_says_is_broken(tmp_path: Path) -> None:
    path, whole = tmp_path / "cut.blf", tmp_path / "whole.blf"
    with can.BLFWriter(str(whole)) as writer:
        for number in range(6000):
            writer.on_message_received(
                can.Message(timestamp=1.0 + number, arbitration_id=0x0CF00400, is_extended_id=True, data=DATA)
            )
    data = whole.read_bytes()
    assert len(list(open_log(whole).frames())) == 6000
    # Between two containers, where nothing of the rest shows that there was more.
    for cut in (data.index(b"LOBJ", data.index(b"LOBJ") + 4), 2 * len(data) // 3):
        path.write_bytes(data[:cut])
        log = open_log(path)
        assert len(list(log.frames())) < 6000
        assert log.counts["broken"] == 1 and "announces 6000 objects" in log.problem


def test_the_shared_logs_have_their_times() -> None:
    if not SHARED.is_dir():
        pytest.skip("the shared cases are not here")
    times = {
        name: [frame.time for frame in open_log(SHARED / name).frames()]
        for name in ("asc_relative_times/log.asc", "candump_as_printed/ta.log", "candump_as_printed/tA.log")
    }
    assert times["asc_relative_times/log.asc"] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert times["candump_as_printed/ta.log"] == pytest.approx([1772359200.0, 1772359200.1])
    assert times["candump_as_printed/tA.log"] == pytest.approx([1772359200.0, 1772359200.1])


def test_an_older_savvycan_log_whose_first_byte_reads_as_a_length_is_not_shifted(tmp_path: Path) -> None:
    frames, _ = read(tmp_path, "a.csv", GVRET.replace("Dir,", "") + "1500000,123,false,0,8,04,01,02,03,04,05,06,07,\n")
    assert [(frame.id, frame.data) for frame in frames] == [(0x123, bytes((4, 1, 2, 3, 4, 5, 6, 7)))]
