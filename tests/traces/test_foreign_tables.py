"""Layouts of programs that are no table of cells between marks: each is the plant, or refused for what it is."""

import gzip
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

import pytest

from sim.lab.recordings import bare_cells, sources
from sim.lab.recordings.foreign_tables import find_layout_of
from sim.lab.recordings.mapping.table import find_table
from sim.lab.recordings.text_encoding import decode_head
from tests.traces.exports import BEGIN, comma, recording
from tests.traces.test_dialects import EPOCH, asked, is_the_plant, mapped

PLANT = recording()
ROWS = list(zip(PLANT.moments, PLANT.heat.tolist(), PLANT.current.tolist(), PLANT.running.tolist(), strict=True))
NAMES = ("Bearing temperature", "Motor current", "Running")


def scope(*, mark: str = "\t", decimal: str = ".", each: bool = False) -> str:
    """TwinCAT Scope: a column of ms for all channels, or one for `each`."""
    begin = int((BEGIN - datetime(1601, 1, 1)).total_seconds() * 1e7)

    def line(key: str, cells: Sequence[str]) -> str:
        return mark.join(part for at, cell in enumerate(cells) for part in ([key, cell] if each or not at else [cell]))

    head = [
        f"Name{mark}plant", f"File{mark}C:\\plant.csv",
        f"Starttime of export{mark}{begin}{mark}Mittwoch, 13. März 2024{mark}09:58:00.000",
        f"Endtime of export{mark}{begin}{mark}Mittwoch, 13. März 2024{mark}10:38:00.000", "", "", line("Name", NAMES),
        line("SymbolComment", ("", "", "")), line("SampleTime[ms]", ("10000",) * 3),
        line("BitMask", ("0xffffffffffffffff",) * 3), line("Unit", ("(None)", "A (Current)", "(None)")), "",
    ]  # fmt: skip
    body = (
        line(str(number * 10_000), [str(value).replace(".", decimal) for value in values])
        for number, (_, *values) in enumerate(ROWS)
    )
    return "\n".join((*head, *body, "EOF")) + "\n"


def measurement() -> str:
    """LabVIEW's, without a column of times."""
    head = [
        "LabVIEW Measurement\t", "Writer_Version\t2", "Separator\tTab", "Decimal_Separator\t.", "X_Columns\tNo",
        "Date\t2024/03/13", "Time\t09:58:00,938945770263671875", "***End_of_Header***\t", "\t", "Channels\t3\t\t",
        "Samples\t240\t240\t240", "Date\t2024/03/13\t2024/03/13\t2024/03/13", "Time\t09:58:00\t09:58:00\t09:58:00",
        "X_Dimension\tTime\tTime\tTime", "X0\t0.0000000000000000E+0\t0.0\t0.0", "Delta_X\t10.0\t10.0\t10.0",
        "***End_of_Header***\t", "\t".join(("X_Value", *NAMES, "Comment")),
    ]  # fmt: skip
    return "\n".join((*head, *(f"\t{heat}\t{load}\t{on}" for _, heat, load, on in ROWS))) + "\n"


def fast_load() -> str:
    tags = ("Bearing.Temperature", "Motor.Current", "Motor.Running")
    body = [
        f"{tag}|0|{moment:%Y/%m/%d}|{moment:%H:%M:%S}.000|1|{value}|192"
        for moment, *values in ROWS
        for tag, value in zip(tags, values, strict=True)
    ]
    return "\n".join(("ASCII", "|", "Admin,1,Server Local,1,2", *body)) + "\n"


def recorder() -> str:
    """A paper recorder's: tags and units in rows of their own."""
    head = ('"Ch.","","","CH1","CH2","CH3"', '"Tag","","","Bearing temperature","Motor current","Running"',
            '"Unit","","","°C","A",""', '"Date","Time","sec","Value","Value","Value"')  # fmt: skip
    body = (f'"{moment:%Y/%m/%d}","{moment:%H:%M:%S}","0.0",{heat},{load},{on}' for moment, heat, load, on in ROWS)
    return "\n".join((*head, *body)) + "\n"


def trend() -> str:
    """A controller's trend: thousandths of a second behind a semicolon."""
    head = ('Controller Name:,"Line"', "Trend Tags:,3", "Sample Period:,10000 ms", "",
            'Header:,Date,Time,"Bearing_temperature","Motor_current","Running"')  # fmt: skip
    body = (f"Data,{moment:%m/%d/%Y},{moment:%H:%M:%S};000,{heat},{load},{on}" for moment, heat, load, on in ROWS)
    return "\n".join((*head, *body)) + "\n"


def aligned(names: Sequence[str], widths: Sequence[int], clock: Callable[[datetime], str],
            number: Callable[[float], str] = str) -> str:  # fmt: skip
    rows = [names, *((clock(moment), *map(number, values)) for moment, *values in ROWS)]
    return "\n".join("  ".join(str(c).rjust(w) for c, w in zip(row, widths, strict=True)) for row in rows) + "\n"


def ruled() -> str:
    """A console of a database, with what it says behind its rows."""
    widths = (23, 22, 22, 7)
    rows = [("Time", *NAMES), tuple("-" * width for width in widths),
            *((f"{moment:%Y-%m-%d %H:%M:%S}.000", *values) for moment, *values in ROWS)]  # fmt: skip
    body = (" ".join(str(cell).ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)
    return "\n".join((*body, "", "(240 rows affected)", "", "Completion time: 2024-03-13T10:38:00+01:00")) + "\n"


def ns(moment: datetime) -> int:
    return int((moment - EPOCH).total_seconds()) * 10**9


def points() -> str:
    return "".join(
        f"decanter,machine=D\\ 1 bearing_temperature={heat},motor_current={load},running={'tf'[not on]} {ns(moment)}\n"
        for moment, heat, load, on in ROWS
    )


def points_by_measurement() -> str:
    return "".join(
        f"{name},host=plc value={value} {ns(moment)}\n"
        for moment, heat, load, on in ROWS
        for name, value in (("bearing_temperature", heat), ("motor_current", load), ("running", f"{on}i"))
    )


WIDTHS = (19, 20, 14, 8)
LAYOUTS: dict[str, tuple[str, Callable[[], str]]] = {
    "scope": ("e.csv", scope),
    "scope, a clock each": ("e.txt", lambda: scope(mark=";", decimal=",", each=True)),
    "measurement": ("e.lvm", measurement),
    "fast load": ("e.csv", fast_load),
    "recorder": ("e.csv", recorder),
    "trend": ("e.csv", trend),
    "aligned": ("e.txt", lambda: aligned(("Time", *NAMES), WIDTHS, "{:%Y-%m-%d %H:%M:%S}".format)),
    "aligned, German": (
        "e.txt",
        lambda: aligned(
            ("Zeit", "Lagertemperatur", "Motorstrom", "Betrieb"), WIDTHS, "{:%d.%m.%Y %H:%M:%S}".format, comma
        ),
    ),
    "blanks": (
        "e.dat",
        lambda: (
            "Date Time Bearing_temp Motor_current Running\n"
            + "".join(f"{moment:%Y-%m-%d %H:%M:%S} {heat} {load} {on}\n" for moment, heat, load, on in ROWS)
        ),
    ),
    "ruled": ("e.rpt", ruled),
    "points": ("e.lp", points),
    "points by measurement": ("e.txt", points_by_measurement),
    "for a spreadsheet": (
        "e.csv",
        lambda: (
            '="Time",="Bearing temperature",="Motor current",="Running"\n'
            + "".join(f'="{moment}",="{heat}",="{load}","=""{on}"""\n' for moment, heat, load, on in ROWS)
        ),
    ),
}


@pytest.mark.parametrize("layout", [*LAYOUTS, "packed"])
def test_a_layout_of_a_program_is_the_plant(layout: str, tmp_path: Path) -> None:
    """They were refused for reasons that were none, such as a column BitMask that holds no times."""
    name, text = LAYOUTS.get(layout, LAYOUTS["scope"])
    export = tmp_path / (f"{name}.gz" if layout == "packed" else name)
    export.write_bytes(gzip.compress(text().encode()) if layout == "packed" else text().encode())
    (trace,), report, _ = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert trace.times[0] == (BEGIN - EPOCH).total_seconds()
    assert report.refused == (2 if layout == "ruled" else 0)


def test_names_in_shift_jis(tmp_path: Path) -> None:
    """They were read in a Western code page, and asked for as such."""
    export = tmp_path / "e.csv"
    rows = "".join(f"{moment:%Y/%m/%d %H:%M:%S},{heat},{load},{on}\n" for moment, heat, load, on in ROWS)
    export.write_bytes(f"日時,軸受温度,モータ電流,運転\n{rows}".encode("cp932"))
    (trace,), _, said = mapped(export, tmp_path / "m.toml")
    is_the_plant(trace, tmp_path / "m.toml")
    assert said["temperature"] == "軸受温度" and said["current"] == "モータ電流"


@pytest.mark.parametrize("words", ["Lagertemperatur [°C] Kälte für Wärme", "Température étuve – entrée", "“Tür” €"])
def test_western_names_are_not_taken_for_japanese(words: str, tmp_path: Path) -> None:
    export = tmp_path / "e.csv"
    rows = "".join(f"{moment};{heat};{load};{on}\n" for moment, heat, load, on in ROWS)
    export.write_bytes(f"Time;Bearing temperature;Motor current;Running {words}\n{rows}".encode("cp1252"))
    mapped(export, tmp_path / "m.toml")
    assert words in (tmp_path / "m.toml").read_text(encoding="utf-8").replace('\\"', '"')


def test_commas_that_are_decimal_marks_and_part_the_cells_are_refused_as_such(tmp_path: Path) -> None:
    """The reason was that no form of a time reads a blank cell."""
    export = tmp_path / "e.csv"
    rows = (f"{moment},{comma(heat)},{comma(load)},{on}\n" for moment, heat, load, on in ROWS)
    export.write_text(f"Time,{','.join(NAMES)}\n{''.join(rows)}", encoding="utf-8")
    assert "its commas are decimal marks and part the cells" in asked(export, tmp_path / "m.toml")


def test_channels_of_several_steps_have_no_common_time(tmp_path: Path) -> None:
    export = tmp_path / "e.lvm"
    export.write_text(measurement().replace("Delta_X\t10.0\t10.0\t10.0", "Delta_X\t10.0\t1.0\t10.0"), encoding="utf-8")
    assert "Delta_X and X0 are not one value" in asked(export, tmp_path / "m.toml")


def test_what_is_no_row_of_the_layout_costs_itself_alone(tmp_path: Path) -> None:
    """It is counted among the rows, and refused."""
    for name, text, odd in (("e.lp", points(), "decanter bearing_temperature=\n"),
                            ("e.csv", fast_load(), "Bearing.Temperature|0|2024/03/13\n"),
                            ("e.txt", LAYOUTS["aligned"][1](), "recorder restarted\n")):  # fmt: skip
        export = tmp_path / name
        lines = text.splitlines(keepends=True)
        export.write_text("".join([*lines[:100], odd, *lines[100:]]), encoding="utf-8")
        (trace,), report, _ = mapped(export, tmp_path / f"{name}.toml")
        is_the_plant(trace, tmp_path / f"{name}.toml")
        assert report.refused == 1, name


@pytest.mark.parametrize("names", ["Time,Bearing temperature,Standstill", "Time,Motor running,Bearing temperature"])
def test_blanks_within_names_and_times_of_a_csv_part_no_columns(names: str) -> None:
    """Its rows have as many blanks as its header."""
    rows = "".join(f"{moment},{heat},{on}\n" for moment, heat, _, on in ROWS)
    assert find_layout_of(f"{names}\n{rows}") is None
    assert find_layout_of(f"Plant export\n{names}\n{rows}") is None


def test_a_text_that_a_table_of_ours_guards_stays_what_it_is() -> None:
    assert bare_cells(['="45.2"', '\'="45.2"', '="say ""no"""', "'=1+1", "-5"]) == [
        "45.2", '="45.2"', 'say "no"', "=1+1", "-5"
    ]  # fmt: skip


def test_a_measurement_that_goes_on_below_another_header_is_refused(tmp_path: Path) -> None:
    """What the header says were readings, and the rows behind it late."""
    head, end, rows = measurement().rpartition("***End_of_Header***\t\n")
    names, *body = rows.splitlines(keepends=True)
    segment = head[head.index("Channels") :].replace("240", "120") + end + names
    export = tmp_path / "e.lvm"
    export.write_text("".join((head, end, names, *body[:120], segment, *body[120:])), encoding="utf-8")
    assert "go on below another header" in asked(export, tmp_path / "m.toml")


def test_a_blank_row_of_a_measurement_takes_its_step(tmp_path: Path) -> None:
    """All behind it were early."""
    lines = measurement().splitlines(keepends=True)
    export = tmp_path / "e.lvm"
    export.write_text("".join([*lines[:100], "\t\t\t\n", *lines[101:], "\n"]), encoding="utf-8")
    (trace,), _, _ = mapped(export, tmp_path / "m.toml")
    assert trace.times[-1] - trace.times[0] == 10.0 * (len(ROWS) - 1)
    export.write_text("".join([*lines[:100], "\n", *lines[100:]]), encoding="utf-8")
    assert "whether it took a step cannot be told" in asked(export, tmp_path / "m2.toml")


@pytest.mark.parametrize(
    "odd", ["{time}        150.1 1 Manual run", "{time} 45.2  1 NOT OK", "{time} 45.2 150.1  Manual"]
)
def test_a_row_with_a_blank_cell_between_single_blanks_is_none(odd: str, tmp_path: Path) -> None:
    """One with two words beside it was the current as the temperature."""
    rows = [f"{moment:%Y-%m-%d %H:%M:%S} {heat} {load} {on} Auto\n" for moment, heat, load, on in ROWS]
    rows[100] = odd.format(time=f"{ROWS[100][0]:%Y-%m-%d %H:%M:%S}") + "\n"
    export = tmp_path / "e.txt"
    export.write_text("Date Time Bearing_temp Motor_current Running Mode\n" + "".join(rows), encoding="utf-8")
    (trace,), report, said = mapped(export, tmp_path / "m.toml")
    heat = [float(value) for value in trace.signals[said["temperature"]]]
    assert report.refused == 1 and max(heat) == max(PLANT.heat.tolist())


def test_tags_of_points_are_told_apart_by_what_is_escaped_and_by_their_last_letter() -> None:
    """Two machines were one."""
    lines = ["m,line=A\\,1,at=1i,own=C:\\a t=45.2,s=\"x, \\\"y\\\"\",n=3i 1710324000000000000\n",
             "m,line=A\\,2,at=1u,own=\"b\" t=46.2 1710324010000000000\n"]  # fmt: skip
    assert (to_rows := find_layout_of("".join(lines))) is not None
    assert list(to_rows(lines)) == [
        ["time", "line", "at", "own", "t", "s", "n"],
        ["1710324000000000000", "A,1", "1i", "C:\\a", "45.2", 'x, "y"', "3"],
        ["1710324010000000000", "A,2", "1u", '"b"', "46.2", "", ""],
    ]


def test_a_bad_row_among_the_first_or_with_a_bad_clock_costs_itself_alone(tmp_path: Path) -> None:
    """The file was no such layout, or refused as a whole."""
    lines = points().splitlines(keepends=True)
    for name, text, lost, refused in (
        ("e.lp", "".join([*lines[:9], "decanter bearing_temperature=\n", *lines[9:]]), 0, 1),
        # The clock of a row there is that of three readings.
        ("e.csv", scope().replace("\n1000000\t", "\n1000000x\t"), 1, len(NAMES)),
    ):
        export = tmp_path / name
        export.write_text(text, encoding="utf-8")
        (trace,), report, _ = mapped(export, tmp_path / f"{name}.toml")
        assert report.refused == refused, name
        assert len(trace.times) == len(ROWS) - lost
        assert trace.times[-1] == (PLANT.moments[-1] - EPOCH).total_seconds()


@pytest.mark.parametrize("each", [
    ("Time                 Bearing_temperature  Motor_current", "-------------------  ----  -------------"),
    ("Time Bearing_temperature Motor_current", "---- ------------------- -------------"),
])  # fmt: skip
def test_a_ruler_that_is_as_wide_as_names_tells_no_columns(each: Sequence[str]) -> None:
    """The longest cells were refused, or all of them."""
    rows = [f"{moment:%Y-%m-%d %H:%M:%S} {heat} {load}" for moment, heat, load, _ in ROWS[:50]]
    assert find_layout_of("\n".join((*each, *rows))) is None
    assert find_layout_of(ruled()) is not None


@pytest.mark.parametrize("header", [
    "Ora;Temperatura dell’olio;Corrente dell’azionamento;Marcia", "Time;Bearing’s temperature;Motor’s current;Running",
    "Heure;Température d’huile;Niveau d’eau;Marche d’aération",
])  # fmt: skip
def test_apostrophes_before_letters_are_no_japanese(header: str, tmp_path: Path) -> None:
    """An apostrophe of cp1252 with the letter behind it is a letter of Shift-JIS."""
    assert decode_head(tmp_path, f"{header}\n".encode("cp1252"), "auto")[:2] == ("cp1252", f"{header}\n")


def test_apostrophes_are_none_in_slavic_words_either(tmp_path: Path) -> None:
    text = "Čas;Temperatura ležaja;Obtežitev;Ležišče\n".encode("cp1250")
    assert decode_head(tmp_path, text, "auto")[0] == "cp1252"


def test_a_recorder_below_whose_tags_stand_full_names_is_a_table(tmp_path: Path) -> None:
    """Its names were doubled."""
    rows = "".join(f"{moment},{heat},{load},{on}\n" for moment, heat, load, on in ROWS)
    head = f"Tag,Bearing,Decanter,Decanter\nUnit,°C,A,\nDate,{','.join(NAMES)}\n"
    assert find_layout_of(head + rows) is None
    assert find_layout_of(recorder()) is not None


def test_a_recorders_parts_of_a_second_are_of_its_time() -> None:
    """Rows of one second had one time."""
    lines = [line.replace('"0.0"', part) for line, part in zip(
        recorder().splitlines()[:8], ["", "", "", "", '"0.0"', '"0.500"', '".25"', '"30"'], strict=True)]  # fmt: skip
    assert (to_rows := find_layout_of(recorder())) is not None
    assert [row[1] for row in to_rows(lines)] == ["Time", "09:58:00", "09:58:10.500", "09:58:20.25", "09:58:30 30"]


@pytest.mark.parametrize("header", ["Time,Temp,,Current,,Running,", "Time,Temp,State,Current,,Running,State"])
def test_columns_with_blank_names_are_no_decimals(header: str, tmp_path: Path) -> None:
    """Whole numbers beside them were refused as numbers with decimal commas."""
    rows = "".join(f"{moment},{heat:.0f},192,{load:.0f},192,{on},192\n" for moment, heat, load, on in ROWS)
    export = tmp_path / "e.csv"
    export.write_text(f"{header}\n{rows}", encoding="utf-8")
    assert find_table(export).header[1] == "Temp"


def test_one_cell_more_than_names_may_be_a_column_without_a_name(tmp_path: Path) -> None:
    export = tmp_path / "e.csv"
    rows = "".join(f"{moment},{heat:.0f},{load:.0f},{on},192\n" for moment, heat, load, on in ROWS)
    export.write_text(f"Time,Temp,Current,Running\n{rows}", encoding="utf-8")
    assert "too, or its last column has no name" in asked(export, tmp_path / "m.toml")


@pytest.mark.parametrize("layout", ["points", "recorder"])
def test_a_text_that_is_too_long_is_refused_as_such(
    layout: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was in memory whatever its length, and a long cell of a recorder a traceback."""
    name, text = LAYOUTS[layout]
    export = tmp_path / name
    export.write_text(f"{text()}{'9' * 200_000}\n", encoding="utf-8")
    assert "of its lines has more than 131072 letters" in asked(export, tmp_path / "m.toml")
    export.write_text(text(), encoding="utf-8")
    monkeypatch.setattr(sources, "MAX_UNPACKED_BYTES", 10_000)
    assert "MiB are the most" in asked(export, tmp_path / "m.toml")


def test_columns_whose_cells_do_not_stand_below_their_names_are_none(tmp_path: Path) -> None:
    """A blank column beside two names with one blank between them shifted what stands between."""
    widths = (19, 5, 19, 7, 7)
    names = "Time                 Fault  Bearing temperature Current  Running"
    rows = (
        "  ".join(str(cell).rjust(width) for cell, width in zip((moment, "", *values), widths, strict=True))
        for moment, *values in ROWS
    )
    assert find_layout_of("\n".join((names, *rows))) is None
    lines = LAYOUTS["aligned"][1]().splitlines(keepends=True)
    moment, heat = f"{ROWS[99][0]:%Y-%m-%d %H:%M:%S}", str(ROWS[99][1])
    lines[100] = f"{moment:>19}  {'':20}  {heat:>14}  {'NOT  OK':>8}\n"
    export = tmp_path / "e.txt"
    export.write_text("".join(lines), encoding="utf-8")
    _, report, _ = mapped(export, tmp_path / "m.toml")
    assert report.refused == 1
