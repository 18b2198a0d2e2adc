"""Counts, lengths and depths that a file gives were believed: a hang, 323 MB for 7 kB, tracebacks of libraries."""

import io
import time
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from openpyxl import Workbook

from drivers.can.dbc import Dbc
from drivers.canopen.eds import parse_sheet
from drivers.errors import DriverError
from drivers.named_files import contents, parse_toml, unusable
from drivers.settings import ConfigError, read_toml
from drivers.tag import Tag
from gateway.commission.files.cells import ListError, read_sheet
from sim.artefacts.model_json import parse_model
from sim.files import ArtefactError
from sim.lab.recordings.alphabet_table import alphabet_from_table
from sim.sha import Distribution, check_distribution
from tests.gateway.support import ROOT

DBC = (
    'VERSION ""\nNS_ :\nBS_:\nBU_: A\n\n'
    "BO_ {id} M{id}: {length} A\n"
    ' SG_ S {mux}: {start}|{bits}@1+ ({scale},0) [0|0] "" A\n'
)
MOST_SECONDS, MOST_BYTES = 5.0, 60 << 20
"""Processor time, which other work on the machine does not lengthen, and memory."""


def refused(error: type[Exception], act: Callable[[], object]) -> str:
    """The one line with which `act` refuses, in bounded time and memory."""
    tracemalloc.start()
    begun = time.process_time()
    try:
        with pytest.raises(error) as raised:
            act()
        assert tracemalloc.get_traced_memory()[1] < MOST_BYTES and time.process_time() - begun < MOST_SECONDS
    finally:
        tracemalloc.stop()
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 600
    return str(raised.value)


@pytest.mark.parametrize("count", ["0x21001510", "255", "-1", "0x" + "f" * 500])
def test_a_count_of_mapped_objects_is_none_that_a_pdo_can_hold(count: str) -> None:
    text = (ROOT / "config/decanter.eds").read_text()
    section = text.index("[1A00sub0]")
    for kind in ("0x0005", "0x0007"):  # the count may come with a type that has room for it
        before, body = text[:section], text[section:]
        body = body.replace("DataType=0x0005", f"DataType={kind}", 1)
        at = body.index("DefaultValue=")
        body = body[:at] + f"DefaultValue={count}" + body[body.index("\n", at) :]
        begun = time.process_time()
        try:
            pdos = parse_sheet(before + body, 1, "x.eds").pdos("T")
        except DriverError as error:
            assert "0x1A00:0 is" in str(error) or "digits" in str(error)
        else:  # no number of its type is no value: nothing is mapped
            assert not pdos[0].objects
        assert time.process_time() - begun < MOST_SECONDS


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"length": 100_000_000}, "line 6 has a message of 100000000 bytes"),
        ({"bits": 100_000_000}, "a signal up to bit 100000000"),
        ({"start": 100_000_000}, "a signal up to bit 100000008"),
    ],
)
def test_a_dbc_says_which_size_is_beyond_any_bus(tmp_path: Path, changes: dict[str, int], words: str) -> None:
    path = tmp_path / "x.dbc"
    fields = {"id": 1, "length": 8, "mux": "", "start": 0, "bits": 8, "scale": 1} | changes
    path.write_text(DBC.format(**fields))
    assert words in refused(DriverError, lambda: Dbc(path))


def test_many_large_messages_and_ranges_of_a_multiplexor_are_bounded_together(tmp_path: Path) -> None:
    path = tmp_path / "x.dbc"
    frame = "BO_ {0} M{0}: 1785 A\n"
    ' SG_ S : 14000|8@1+ (1,0) [0|0] "" A\n\n'
    path.write_text('VERSION ""\nNS_ :\nBS_:\nBU_: A\n\n' + "".join(map(frame.format, range(1, 4000))))
    assert "bytes" in refused(DriverError, lambda: Dbc(path))
    fields = {"id": 1, "length": 8, "mux": "M ", "start": 0, "bits": 8, "scale": 1}
    path.write_text(DBC.format(**fields) + "\nSG_MUL_VAL_ 1 S S 0-3000000;\n")
    assert "multiplexor values to 3000001" in refused(DriverError, lambda: Dbc(path))


@pytest.mark.parametrize("scale", ["1" + "0" * 350, "1e999"])
def test_a_scale_beyond_any_number_is_refused_with_its_tag(tmp_path: Path, scale: str) -> None:
    path = tmp_path / "x.dbc"
    path.write_text(DBC.format(id=1, length=8, mux="", start=0, bits=8, scale=scale))
    assert "scale" in refused(DriverError, lambda: Dbc(path).locate(Tag("T", "dbc:M1.S")))


def workbook() -> bytes:
    book, stream = Workbook(), io.BytesIO()
    sheet = book.active
    assert sheet is not None
    for row in (("name", "address"), ("T", 40101)):
        sheet.append(row)
    book.save(stream)
    return stream.getvalue()


def with_part(data: bytes, name: str, change: Callable[[bytes], bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as old, zipfile.ZipFile(stream, "w", method) as new:
        for part in old.infolist():
            body = old.read(part)
            new.writestr(part.filename, change(body) if part.filename == name else body)
    return stream.getvalue()


SHEET = "xl/worksheets/sheet1.xml"
LAUGHS = (
    b'<!DOCTYPE l [<!ENTITY a "ha">'
    + b"".join(b'<!ENTITY %c "%s">' % (98 + n, b"&%c;" % (97 + n) * 10) for n in range(12))
    + b"]>"
)


def damaged(data: bytes) -> bytes:
    """Noise inside the compressed sheet."""
    at = data.index(SHEET.encode()) + len(SHEET) + 30
    return data[:at] + bytes(255 - byte for byte in data[at : at + 40]) + data[at + 40 :]


@pytest.mark.parametrize(
    "spoilt",
    [
        damaged,
        lambda data: data[: len(data) // 2],
        lambda data: data.replace(b"\x08\x00", b"\x63\x00"),  # a compression method that nobody has
        lambda data: with_part(data, SHEET, lambda body: b" " * (80 << 20)),
        lambda data: with_part(data, SHEET, lambda body: LAUGHS + body[body.index(b"<worksheet") :]),
        lambda data: with_part(data, SHEET, lambda body: body.replace(b'<row r="2"', b'<row r="999999999"')),
        lambda data: with_part(data, "xl/workbook.xml", lambda body: body[:50] + body[90:]),
        lambda data: with_part(data, "xl/workbook.xml", lambda body: b"<workbook/>"),
        lambda data: with_part(data, SHEET, lambda body: body.replace(b'r="B2"', b'r="ZZZZ2"')),
    ],
)
def test_a_spoilt_workbook_is_one_sentence(tmp_path: Path, spoilt: Callable[[bytes], bytes]) -> None:
    path = tmp_path / "list.xlsx"
    path.write_bytes(spoilt(workbook()))
    columns = {"name": ("name",), "address": ("address",)}
    assert str(path) in refused(ListError, lambda: read_sheet(path, columns, ("name", "address")))


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 2000,
        "a = " + "{a=" * 200 + "1" + "}" * 200,
        "a." * 5000 + "a = 1",
        "a." * 100 + "a = 1",
        "[" + "a." * 100 + "a]\nb = 1",
        "a = 0x" + "f" * 6000,
        "a = " + "_".join("1" * 5000),
        "a = 2024-13-01",
        'a = "' + "x" * (2 << 20) + '"',
    ],
)
def test_toml_of_any_depth_and_size_is_a_sentence(tmp_path: Path, text: str) -> None:
    path = tmp_path / "plant.toml"
    path.write_text(text)
    assert str(path) in refused(ConfigError, lambda: read_toml(path))


def test_what_is_within_the_bounds_is_read() -> None:
    assert parse_toml("a = [" + ", ".join(["1.5"] * 500) + "]\nb.c.d = 1979-05-27")["b"]
    assert not unusable({"a": [[[{}]]], "b": 10**300, "c": "é"})
    assert "surrogate" in unusable({"a": ["\ud800"]})


def test_a_model_is_refused_for_depth_text_and_laws_beyond_the_floating_point_numbers() -> None:
    for text in ("[" * 100_000, "{" * 10 + '"a":' * 10, '{"a":' * 500 + "1" + "}" * 500, '{"format": "\\ud800"}'):
        refused(ArtefactError, lambda text=text: parse_model(text))  # type: ignore[misc]
    laws = [
        Distribution("weibull", {"shape": 1e-9, "scale": 1.0}),
        Distribution("lognormal", {"mu": 1000.0, "sigma": 1.0}),
        Distribution("lognormal", {"mu": 0.0, "sigma": 1e200}),
        Distribution("normal", {"mu": 0.0, "sigma": 1e200}),
        Distribution("exponential", {"mean": 1e300}),
    ]
    for law in laws:
        assert "beyond all numbers" in refused(ValueError, lambda law=law: check_distribution(law))  # type: ignore[misc]


def test_an_alphabet_of_infinite_steps_is_refused() -> None:
    for last, step in ((1e308, 1e-300), (float("inf"), 1.0), (1.0, 5e-324)):
        bins = {"kind": "bins", "signal": "I", "thresholds": {"first": 0, "last": last, "step": step}, "symbols": ["a"]}
        table = {"channels": [bins]}
        refused(ValueError, lambda table=table: alphabet_from_table(table, "x.toml: alphabet"))  # type: ignore[misc]


def test_a_file_that_is_held_whole_has_a_bound(tmp_path: Path) -> None:
    path = tmp_path / "x"
    with path.open("wb") as stream:
        stream.truncate(3 << 20)
    assert len(contents(path)) == 3 << 20
    with pytest.raises(OSError, match="more than 2 MiB"):
        contents(path, 2 << 20)
