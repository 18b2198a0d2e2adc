"""The table of targets: what is fuzzed, from which valid examples, and with which errors it may refuse."""

import io
import re
import struct
import tempfile
import zipfile
from binascii import crc_hqx
from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import can
import numpy as np

from drivers.can.dbc import Dbc
from drivers.canopen.eds import load_sheet
from drivers.canopen.place import ObjectPlace
from drivers.canopen.sdo import block_download, block_upload, download, upload
from drivers.device_file import read_device_file
from drivers.errors import AddressError, DeviceException, DriverError, ReplyMismatch
from drivers.modbus import rtu
from drivers.settings import ConfigError
from drivers.tag import Tag
from drivers.vehicle.log import Log
from gateway.commission.files.cells import ListError, read_sheet
from gateway.settings import load_config
from sim import familiarity
from sim.artefacts.effect_lines import read_effect_lines
from sim.artefacts.familiarity_file import FAMILIARITY_FILE, Familiarity, read_familiarity
from sim.artefacts.model_json import model_text, read_model_file
from sim.familiarity import error_curve, fit_reference
from sim.files import ArtefactError
from sim.lab.checking.language.parse import QueryError, parse_query
from sim.lab.formats.foreign.dot import read_source
from sim.lab.formats.foreign.flow_file import read_flow_file
from sim.lab.formats.foreign.histogram import read_histogram
from sim.lab.formats.foreign.report import read_report
from sim.lab.recordings import ColumnMap, load_map
from sim.lab.recordings.load_report import TraceError
from sim.lab.recordings.traces import load_traces
from sim.plc.modbus import framing
from sim.plc.modbus.server import make_rtu_tcp
from sim.plc.modbus.tls import make as make_tls
from sim.plc.program import InputError
from sim.plc.record.recording import read_recording
from sim.sha import Model
from tests.cases.input_without_a_bound.test_input_without_a_bound import with_part, workbook
from tests.fuzz import live, sides
from tests.fuzz.target import FuzzTarget, check_sentence, of_file, of_text, plain
from tests.gateway.support import ROOT, two_modes


def _texts(*texts: str) -> Callable[[], Sequence[bytes]]:
    return lambda: [text.encode() for text in texts]


def _files(*patterns: str) -> Callable[[], Sequence[bytes]]:
    return lambda: [path.read_bytes() for pattern in patterns for path in sorted(ROOT.glob(pattern))]


# ---------------------------------------------------------------- files

REBIRTH = b"\x12\x1a\n\x14Node Control/Rebirth \x0bp\x01"
ACKNOWLEDGEMENT = b"\x12\x2b\n\x19Alarm Control/Acknowledge \x0cz\x0cover limit T"


def _familiarity() -> str:
    points = np.random.default_rng(0).normal(size=(8, 3, len(familiarity.COLUMNS)))
    return Familiarity(fit_reference(list(points)), error_curve([0.5, 1.0], [0.1, 0.2])).text()


DBC = b"""VERSION ""
NS_ :
BS_:
BU_: A
BO_ 291 Motor: 8 A
 SG_ Mode M : 0|8@1+ (1,0) [0|255] "" A
 SG_ Speed m0 : 8|16@1- (0.1,-10) [0|1000] "rpm" A
 SG_ Heat m1 : 23|16@0+ (0.5,0) [0|0] "degC" A
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 291 100;
SG_MUL_VAL_ 291 Heat Mode 1-3;
"""
WRITERS: dict[str, Callable[..., can.io.generic.MessageWriter]] = {
    "candump": can.CanutilsLogWriter,
    "asc": can.ASCWriter,
    "trc": can.TRCWriter,
    "csv": can.CSVWriter,
    "blf": can.BLFWriter,
    "mf4": can.MF4Writer,
}


def _dbc(path: Path) -> object:
    dbc = Dbc(path)
    for name in dbc.messages:
        for signal in ("Mode", "Speed", "Heat"):
            try:
                dbc.locate(Tag("T", f"dbc:{name}.{signal}"))
            except AddressError as error:
                check_sentence(str(error))
    return dbc


def _can_log(name: str) -> FuzzTarget:
    """A log refuses nothing: it counts what is no frame, and says of the first what is wrong."""

    @cache
    def examples() -> Sequence[bytes]:
        frames = [
            can.Message(1.5, 0x123, is_extended_id=False, data=b"\x11\x22", channel=0),
            can.Message(1.6, 0x18FEEE00, data=b"ABCDEFGH", channel=1, is_rx=False),
            can.Message(1.7, 0x77, is_extended_id=False, is_fd=True, data=bytes(12), channel=0),
        ]
        written = []
        with tempfile.TemporaryDirectory() as folder:
            # Compressed too, where a format can be; in what is not, edits reach the objects.
            for options in [{"compression_level": 0}, {}] if name == "blf" else [{}]:
                path = Path(folder) / f"log.{name}"
                with WRITERS[name](path, **options) as writer:
                    for frame in frames:
                        writer.on_message_received(frame)
                written.append(path.read_bytes())
        return written

    def read(path: Path) -> object:
        log = Log(path, name, size=path.stat().st_size)
        frames = list(log.frames())
        assert len(frames) == log.counts["frames"]
        if log.problem:
            check_sentence(log.problem)
        return frames

    def missing() -> str:
        lacking = name == "mf4" and find_spec("asammdf") is None
        return "MF4 is read by asammdf, which is not installed" if lacking else ""

    return FuzzTarget(examples, of_file(f"log.{name}", read), missing=missing)


def _small_eds() -> Sequence[bytes]:
    """The project's own, with one object of each kind: a whole one takes 20 ms, of which the library has all."""
    text = (ROOT / "config/decanter.eds").read_text()
    wanted = r"\[(FileInfo|DeviceInfo|1000|1001|1400|1600|1800|1A00|2000|2100)(sub[0-2])?\]"
    kept = [part for part in re.split(r"(?m)^(?=\[)", text) if re.match(wanted, part)]
    return ["".join(kept).encode()]


def _pdos(path: Path) -> object:
    sheet = load_sheet(path, 1)
    return sheet.pdos("T") + sheet.pdos("R")


PLANT = f'[device]\nfile = "{ROOT}/config/devices/decanter_plc.toml"\nhost = "127.0.0.1"\n\n[scan]\nperiod = 1.0\n'
CSV = b"time,TCuscinettiRiduttore,Assorbimento,MarciaDecanter\n0,25.0,0,0\n1,25.1,80.5,1\n2,,81,1\n# note\n3,nan,82,0\n"
COLUMNS = {"name": ("name",), "address": ("address",)}
DOT = 'digraph G {\n  a [label="q_0"];\n  b;\n  a -> b [label="on"];\n  b -> a [label="off"];\n}\n'
REPORT = "--LEARNED DISTRIBUTIONS--\nD_0(0.004)\nN_9(1, 4)\nD_1(0.02)\n"
FLOWS = ("(x0)' = 0.004 1 + -0.004 x0", "T' = -1e-5*(T - 20)", "(T)' = (50 - T) / 250", "F'==0.004*1-0.004*F")
QUERIES = (
    "Pr[<=444](<> Temp > 60)", "E[<=100; 50](max: Temp)", "A[] !deadlock", "simulate [<=60; 10] {Temp, off}",
    "Pr[<=60]([] off || Temp < 80 && !on) >= 0.9", "on --> off",
)  # fmt: skip
REQUESTS = (
    '{"command": "read", "addresses": [{"address": "holding:100", "dtype": "int16", "scale": 0.1, "order": "AB"}]}\n',
    '{"command": "read", "tags": ["Assorbimento"]}\n',
    '{"command": "arm", "by": "A", "reason": "r", "minutes": 5, "acknowledge": ["a"]}\n',
    '{"command": "disarm", "by": "A", "reason": "r"}\n',
    '{"command": "status"}\n',
)
ORDERS = (
    '{"command": "force", "tag": "Assorbimento", "value": 12.5, "id": 7}\n',
    '{"command": "fault", "fault": {"kind": "exception", "code": 6, "start": 0.5, "duration": 1}}\n',
    '{"command": "fault", "fault": {"kind": "freeze", "tags": ["Assorbimento"]}}\n',
    '{"command": "seek", "position": 12.0}\n',
    '{"command": "acknowledge", "bits": 3}\n',
    '{"command": "release"}\n',
    '{"command": "values"}\n',
)

RECORDING = (
    '{"k": "run", "n": 1, "t": 0.0, "epoch": 0.0, "monotonic": 0.0, "speed": 1.0, "device": "d", "trace": null, '
    '"seed": 0, "roundings": {"A": [0.1, 0.0]}}',
    '{"k": "truth", "n": 2, "t": 0.1, "version": 1, "values": {"A": 1.5}}',
    '{"k": "request", "n": 3, "t": 0.2, "peer": "a:1", "transaction": 1, "unit": 1, "function": 3, "address": 100, '
    '"count": 1, "pdu": "0300640001", "reply": "03020007", "exception": null, "delay_s": 0.0, '
    '"faults": [], "version": 1}',
    '{"k": "block", "n": 4, "t": 0.3, "peer": "a:1", "address": 400, "words": [1, 2], "fields": {"sequence": 1}, '
    '"verdict": "accepted", "accepted": true}',
    '{"k": "frame", "n": 5, "t": 0.4, "face": "can", "sent": true, "id": 385, "data": "0011"}',
    '{"k": "event", "n": 6, "t": 0.5, "event": "fault began", "number": 1}',
)


@cache
def _model() -> Model:
    return two_modes()


@cache
def _columns() -> ColumnMap:
    return load_map(ROOT / "config/traces/decanter.toml")


@cache
def _parts() -> Sequence[bytes]:
    """The workbook's parts, each behind a line with its name: an archive whose checksums are right reaches the XML."""
    with zipfile.ZipFile(io.BytesIO(_workbook())) as book:
        wanted = ("xl/worksheets/sheet1.xml", "xl/workbook.xml", "xl/styles.xml", "xl/sharedStrings.xml")
        return [name.encode() + b"\n" + book.read(name) for name in wanted if name in book.namelist()]


def _with_part(path: Path) -> object:
    name, _, body = path.read_bytes().partition(b"\n")
    path.write_bytes(with_part(_workbook(), name.decode(errors="replace"), lambda _: body, zipfile.ZIP_STORED))
    return _sheet(path)


@cache
def _workbook() -> bytes:
    return workbook()


def _sheet(path: Path) -> object:
    return read_sheet(path, COLUMNS, ("name", "address"))


def _query(text: str) -> object:
    return parse_query(text.replace("Temp", _model().temperature), _model())


def _rtu(*requests: bytes) -> Callable[[], Sequence[bytes]]:
    return lambda: [request + rtu.crc(request) for request in requests]


def _requests() -> Sequence[bytes]:
    write = struct.pack(">HHHBBHHBH", 2, 0, 9, 1, 16, 400, 1, 2, 7)
    return [struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 100, 9), write, b"\0\3\0\0\0\5\1\x2b\x0e\1\0"]


RTU_REQUESTS = _rtu(b"\1\3\0\x64\0\2", b"\1\x10\1\x90\0\1\2\0\7", b"\1\x2b\x0e\1\0")
ARTEFACT_LINE = r".*/x\.\w+(:\d+: |: )"
CRC = crc_hqx(b"ABCDEFGHIJ", 0).to_bytes(2, "little")
PLACE = ObjectPlace(0x2001, 1)
TOML = r"(is not TOML: |byte \d+|[^:]+: )"

OWN_EFFECTS = """
[[effect]]
name = "slurry"
meaning = "what is pumped"
heat = "gain * (feed - temperature) * max(pump, 0) ^ 1.5 / (1 + abs(feed) / knee)"
acts = "anywhere"
experiment = "pump at two temperatures"
signals = { feed = "TFango", pump = "P" }
parameters = { gain = { unit = "1/s", low = 0 }, knee = { unit = "degC", low = 1, high = 50, try = [5] } }
"""


TARGETS: dict[str, FuzzTarget] = {
    "modbus-client": FuzzTarget(
        lambda: [sides.ANSWER, sides.ANSWER * 2],
        plain(sides.modbus_client),
        (ReplyMismatch, DeviceException),
        "holding:100 count 2: |what arrives is not Modbus TCP",
    ),
    "modbus-server": FuzzTarget(_requests, sides.modbus_server(framing.MBAP)),
    "modbus-server-tcp": FuzzTarget(_requests, live.plc_over_tcp(live.make_tcp), most=20_000),
    "peer-server": FuzzTarget(
        lambda: [bytes((1, 3, 0, 0, 0, 5)), bytes((1, 1, 0, 9, 0, 20)), bytes((1, 16, 0, 0, 0, 1, 2, 0, 7))],
        plain(sides.peer_server),
    ),
    "rtu-client": FuzzTarget(
        _rtu(b"\1\3\4\0\1\0\2", b"\1\3\4\xff\xff\0\0"),
        plain(sides.rtu_client),
        (ReplyMismatch, DeviceException),
        "holding:100 count 2: ",
    ),
    "rtu-server": FuzzTarget(RTU_REQUESTS, sides.modbus_server(framing.RTU)),
    "rtu-server-tcp": FuzzTarget(RTU_REQUESTS, live.plc_over_tcp(make_rtu_tcp, rtu_tcp=0), most=20_000),
    "rtu-server-pty": FuzzTarget(RTU_REQUESTS, live.plc_on_a_line, most=1000),
    "tls-client": FuzzTarget(live.records, live.tls_side(of_server=False), (ReplyMismatch,), "what arrives is not"),
    "tls-server": FuzzTarget(live.records, live.tls_side(of_server=True), (ReplyMismatch,), "what arrives is not"),
    "tls-server-tcp": FuzzTarget(live.records, live.plc_over_tcp(make_tls, tls_port=0, tls_role=()), most=20_000),
    "tls-certificate": FuzzTarget(
        lambda: [live.client_certificate()], live.tls_files, (DriverError,), "modbus: certificates: .*; make them anew"
    ),
    "can-fields": FuzzTarget(
        lambda: [
            b"0x181:16|16\nABCDEFGH",
            b"0x181:7|16@0\nABCDEFGHIJ",
            b"0x181[0|8=65]:8|16\nABCDEFGHIJK",
            b"0x00000181[0|8=65,63|4@0=1]:0|8\nABCDEFGH",
            b"0x123:0|32\n1234",
            b"0x123:0|1\n\1",
        ],
        plain(sides.can_fields),
        (AddressError,),
        "T: ",
    ),
    "isotp": FuzzTarget(lambda: [b"\3\x41\x0c\x1aAAAA", b"\x10\x14ABCDEF\x21GHIJKLM\x22NOPQRST"], plain(sides.isotp)),
    "obd": FuzzTarget(
        lambda: [
            b"\4\x41\x0c\x1a\xf8AAA\3\x41\5\x7bAAAA\3\x7f\1\x12AAAA",
            b"\x10\x14\x49\2\1ABC\x21DEFGHIJ\x22KLMNOPQ",
        ],
        plain(sides.obd),
    ),
    "j1939": FuzzTarget(
        lambda: [b"\x20\x0e\0\2\xff\xca\xfe\0\1ABCDEFG\2HIJKLMN", b"\x10\x0e\0\2\xff\xca\xfe\0\1ABCDEFG\2HIJKLMN"],
        plain(sides.j1939),
    ),
    "canopen-sdo": FuzzTarget(
        lambda: [b"\x4b\1\x20\1\7\0\0\0", b"\x41\1\x20\1\x0a\0\0\0\0ABCDEFG\x19HIJ\0\0\0\0"],
        plain(sides.sdo_client(lambda: upload(PLACE))),
        (DriverError,),
        "0x2001:1: ",
    ),
    "canopen-sdo-block": FuzzTarget(
        lambda: [b"\xc6\1\x20\1\x0a\0\0\0\1ABCDEFG\x82HIJ\0\0\0\0\xd1" + CRC + bytes(5)],
        plain(sides.sdo_client(lambda: block_upload(PLACE))),
        (DriverError,),
        "0x2001:1: ",
    ),
    "canopen-sdo-write": FuzzTarget(
        lambda: [b"\x60\1\x20\1\0\0\0\0\x20" + bytes(7) + b"\x30" + bytes(7)],
        plain(sides.sdo_client(lambda: download(PLACE, b"ABCDEFGHIJ"))),
        (DriverError,),
        "0x2001:1: ",
    ),
    "canopen-sdo-block-write": FuzzTarget(
        lambda: [b"\xa4\1\x20\1\x40\0\0\0\xa2\2\x40" + bytes(5) + b"\xa1" + bytes(7)],
        plain(sides.sdo_client(lambda: block_download(PLACE, b"ABCDEFGHIJ"))),
        (DriverError,),
        "0x2001:1: ",
    ),
    "canopen-node": FuzzTarget(
        lambda: [
            b"\0\x40\1\x20\1\0\0\0\0",
            b"\0\x40\x21\x10\0\0\0\0\0\x60" + bytes(7) + b"\x70" + bytes(7),
            b"\0\xa0\x21\x10\0\x20\0\0\0\xa3" + bytes(7) + b"\xa2\x20\x20" + bytes(5),
            b"\0\x21\2\x21\0\x0a\0\0\0\0ABCDEFG\x19HIJ\0\0\0\0",
            b"\0\xc6\2\x21\0\x0a\0\0\0\1ABCDEFG\x82HIJ\0\0\0\0\xd1" + CRC + bytes(5),
            b"\x80\x40\1\x20\1\0\0\0\0\0\1\1\0\0\0\0\0\x40\1\x20\1\0\0\0\0\2ABCDEFG",
        ],
        sides.canopen_node,
    ),
    "canopen-pdo": FuzzTarget(lambda: [b"\x10\x10\x08\x18ABCDEFGH"], plain(sides.canopen_pdo), (DriverError,), "PDO: "),
    "canopen-emcy": FuzzTarget(lambda: [b"\x10\x42\x09ABCDE\0\0\0\0\0\0\0\0"], plain(sides.emergency)),
    "eds": FuzzTarget(_small_eds, of_file("x.eds", _pdos), (DriverError,), ".*x.eds"),
    "dbc": FuzzTarget(lambda: [DBC], of_file("x.dbc", _dbc), (DriverError,), ".*/x.dbc: "),
    **{f"log-{name}": _can_log(name) for name in WRITERS},
    "csv": FuzzTarget(
        lambda: [CSV], of_file("x.csv", lambda path: load_traces(path, _columns())), (TraceError,), ".*/x.csv: "
    ),
    "column-map": FuzzTarget(
        _files("config/traces/*.toml"), of_file("x.toml", load_map), (TraceError,), r".*/x.toml: "
    ),
    "device-toml": FuzzTarget(
        _files("config/devices/*.toml"), of_file("x.toml", read_device_file), (ConfigError,), rf".*/x.toml: {TOML}"
    ),
    "plant-toml": FuzzTarget(_texts(PLANT), of_file("x.toml", load_config), (ConfigError,), r"/"),
    "dot": FuzzTarget(_texts(DOT), of_file("x.dot", read_source), (ArtefactError,), ARTEFACT_LINE),
    "report": FuzzTarget(_texts(REPORT), of_file("x.txt", read_report), (ArtefactError,), ARTEFACT_LINE),
    "flow-file": FuzzTarget(
        lambda: [f"{number}\n{flow}\n".encode() for number, flow in enumerate(FLOWS)],
        of_file("x.txt", read_flow_file),
        (ArtefactError,),
        ARTEFACT_LINE,
    ),
    "histogram": FuzzTarget(
        _texts("k_0:\n0.1\n0.2\nmu_0:\n25.5\n"), of_file("x.txt", read_histogram), (ArtefactError,), ARTEFACT_LINE
    ),
    "model-json": FuzzTarget(
        lambda: [model_text(_model()).encode()], of_file("x.json", read_model_file), (ArtefactError,), ".*/x.json(:|: )"
    ),
    "effects-toml": FuzzTarget(
        _texts(OWN_EFFECTS), of_file("x.toml", read_effect_lines), (ArtefactError,), r".*/x.toml: "
    ),
    "familiarity": FuzzTarget(
        lambda: [_familiarity().encode()],
        of_file(FAMILIARITY_FILE, lambda path: read_familiarity(path.parent)),
        (ArtefactError,),
        f".*/{FAMILIARITY_FILE}(:|: )",
    ),
    "xlsx": FuzzTarget(
        lambda: [_workbook()],
        of_file("x.xlsx", _sheet),
        (ListError,),
        ".*/x.xlsx: ",
    ),
    "xlsx-part": FuzzTarget(
        _parts,
        of_file("x.xlsx", _with_part),
        (ListError,),
        ".*/x.xlsx: ",
    ),
    "query": FuzzTarget(_texts(*QUERIES), of_text(_query), (QueryError,)),
    "plc-recording": FuzzTarget(
        _texts("".join(f"{row}\n" for row in RECORDING)),
        of_file("x.jsonl", read_recording),
        (InputError,),
        r".*/x.jsonl: ",
    ),
    "sparkplug-command": FuzzTarget(lambda: [REBIRTH, ACKNOWLEDGEMENT], plain(sides.sparkplug_command)),
    "gateway-control": FuzzTarget(_texts(*REQUESTS), live.gateway_control),
    "plc-control": FuzzTarget(_texts(*ORDERS), live.plc_control),
}
"""Every target; a new one is a row here."""
