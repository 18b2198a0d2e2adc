"""The table of targets: what is fuzzed, from which valid examples, and with which errors it may refuse."""

import asyncio
import struct
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from drivers import json_lines
from drivers.can.dbc import Dbc
from drivers.canopen.eds import parse_sheet
from drivers.canopen.emergency import Emergencies
from drivers.canopen.pdo import laid_out
from drivers.canopen.place import ObjectPlace, from_bytes
from drivers.canopen.sdo import Transfer, block_upload, upload
from drivers.device_file import read_device_file
from drivers.errors import DeviceException, DriverError, ReplyMismatch
from drivers.modbus import rtu
from drivers.modbus.verify import Asked, check_reply, split_frames
from drivers.settings import ConfigError
from drivers.tag import DType, Tag
from drivers.vehicle.isotp import Reassembler
from drivers.vehicle.j1939_transport import Key, TransportSessions
from drivers.vehicle.log import Log
from gateway.commission.files.cells import ListError, read_sheet
from gateway.settings import load_config
from sim.artefacts.formats.dot import parse_source
from sim.artefacts.formats.flow_file import parse_flow_file
from sim.artefacts.formats.histogram import parse_histogram
from sim.artefacts.formats.report import parse_report
from sim.artefacts.model_json import model_text, parse_model
from sim.checking.language.parse import QueryError, parse_query
from sim.files import ArtefactError
from sim.plc.modbus import framing
from sim.traces import load_map
from sim.traces.load_report import TraceError
from sim.traces.traces import load_traces
from tests.cases.input_without_a_bound.test_input_without_a_bound import workbook
from tests.gateway.support import ROOT, two_modes


@dataclass(frozen=True, slots=True)
class FuzzTarget:
    """`run(data, folder)` refuses with one of `errors`, in one line, or gives a result that it has checked itself."""

    examples: Callable[[], Sequence[bytes]]
    run: Callable[[bytes, Path], object]
    errors: tuple[type[Exception], ...]


def _texts(*texts: str) -> Callable[[], Sequence[bytes]]:
    return lambda: [text.encode() for text in texts]


def _files(*patterns: str) -> Callable[[], Sequence[bytes]]:
    return lambda: [path.read_bytes() for pattern in patterns for path in sorted(ROOT.glob(pattern))]


def _of_file(name: str, read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    """A parser that takes a path."""

    def run(data: bytes, folder: Path) -> object:
        path = folder / name
        path.write_bytes(data)
        return read(path)

    return run


def _of_text(read: Callable[[str], object]) -> Callable[[bytes, Path], object]:
    return lambda data, _: read(data.decode(errors="replace"))


# ---------------------------------------------------------------- protocol sides

ASKED = Asked(7, 1, 3, 100, 2)
_ANSWER = struct.pack(">HHHBBBHH", 7, 0, 7, 1, 3, 4, 11, 22)


def _modbus_client(data: bytes, _: Path) -> object:
    """What passes the check is the answer, byte for byte, but for the values in it."""
    frames, rest = split_frames(data)
    assert b"".join(frames) + rest == data
    for frame in frames:
        if frame[:2] == _ANSWER[:2]:
            check_reply(ASKED, frame)
            assert frame[:9] == _ANSWER[:9] and len(frame) == len(_ANSWER)
    return frames


def _rtu_client(data: bytes, _: Path) -> object:
    asked = Asked(0, 1, 3, 100, 2)
    length = rtu.reply_length(asked, data)
    if length is None or len(data) < length:
        return None
    check_reply(asked, rtu.unwrapped(asked, data[:length]))
    assert length == 9 and rtu.crc(data[:7]) == data[7:9]
    return rtu.words_of(asked, data[:length])


def _server(read: Callable[[asyncio.StreamReader], object]) -> Callable[[bytes, Path], object]:
    async def serve(data: bytes) -> int:
        reader, count = asyncio.StreamReader(), 0
        reader.feed_data(data)
        reader.feed_eof()
        with suppress(asyncio.IncompleteReadError):
            while not reader.at_eof():
                await read(reader)  # type: ignore[misc]
                count += 1
        return count

    return lambda data, _: asyncio.run(serve(data))


def _frames(data: bytes) -> list[bytes]:
    return [data[at : at + 8] for at in range(0, len(data), 8)]


def _sdo(transfer: Callable[[], Transfer]) -> Callable[[bytes, Path], object]:
    """A transfer fed with eight bytes at a time; what comes out has a bound."""

    def run(data: bytes, _: Path) -> object:
        going = transfer()
        try:
            next(going)
            for frame in _frames(data):
                if len(frame) == 8:
                    going.send(frame)
        except StopIteration as end:
            assert len(end.value) <= len(data)
            return end.value
        return None

    return run


def _isotp(data: bytes, _: Path) -> object:
    reassembler, size = Reassembler(), 0
    for number, frame in enumerate(_frames(data)):
        payload = reassembler.take(0.01 * number, frame)
        size += len(payload or b"")
        assert payload is None or 1 <= len(payload) <= 4095
    assert size <= len(data)
    return reassembler.counts


def _j1939(data: bytes, _: Path) -> object:
    sessions, key = TransportSessions(), Key("can0", 1, 255)
    for number, frame in enumerate(_frames(data)):
        if number % 3:
            sessions.packet(0.01 * number, key, frame)
        else:
            sessions.control(0.01 * number, key, frame)
    return sessions.counts()


def _pdo(data: bytes, _: Path) -> object:
    """A tag's value is GOOD only for the bytes that its type has."""
    objects = laid_out([(ObjectPlace(0x2001, 1 + at), size) for at, size in enumerate(data[:4])], "PDO")
    for mapped in objects:
        piece = mapped.cut(data[4:12])
        value, quality, _ = from_bytes(Tag("T", "0x2001:1", DType.UINT16), piece)
        assert not quality.is_good or (len(piece) == 2 and value == int.from_bytes(piece, "little"))
    return objects


def _emergency(data: bytes, _: Path) -> object:
    emergencies = Emergencies()
    for frame in _frames(data):
        emergencies.take(frame)
    return emergencies.verdict(), emergencies.sentences()


def _can_log(name: str) -> Callable[[bytes, Path], object]:
    def read(path: Path) -> object:
        log = Log(path, name, size=path.stat().st_size)
        frames = list(log.frames())
        assert len(frames) == log.counts["frames"]
        return frames

    return _of_file(f"log.{name}", read)


# ---------------------------------------------------------------- files

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


def _dbc(path: Path) -> object:
    dbc = Dbc(path)
    for name in dbc.messages:
        for signal in ("Mode", "Speed", "Heat"):
            with suppress(DriverError):
                dbc.locate(Tag("T", f"dbc:{name}.{signal}"))
    return dbc


PLANT = f'[device]\nfile = "{ROOT}/config/devices/decanter_plc.toml"\nhost = "127.0.0.1"\n\n[scan]\nperiod = 1.0\n'
CSV = b"time,TCuscinettiRiduttore,Assorbimento,MarciaDecanter\n0,25.0,0,0\n1,25.1,80.5,1\n2,,81,1\n# note\n3,nan,82,0\n"
COLUMNS = {"name": ("name",), "address": ("address",)}
DOT = 'digraph G {\n  a [label="q_0\\nf(t)"];\n  b;\n  a -> b [label="on"];\n  b -> a [label="off"];\n}\n'
REPORT = "--LEARNED DISTRIBUTIONS--\nD_0(0.004)\nN_9(1, 4)\nD_1(0.02)\n"
FLOWS = ("(x0)' = 0.004 1 + -0.004 x0", "T' = -1e-5*(T - 20)", "(T)' = (50 - T) / 250", "F'==0.004*1-0.004*F")
QUERIES = (
    "Pr[<=444](<> Temp > 60)", "E[<=100; 50](max: Temp)", "A[] not deadlock", "simulate 10 [<=60] {Temp, off}",
    "Pr[<=60]([] off || Temp < 80 and !on) >= 0.9", "on --> off",
)  # fmt: skip
REQUESTS = ('{"command": "read", "tags": ["a"]}\n', '{"command": "arm", "by": "A", "reason": "r", "minutes": 5}\n')


@cache
def _model() -> str:
    return model_text(two_modes())


TARGETS: dict[str, FuzzTarget] = {
    "modbus-client": FuzzTarget(lambda: [_ANSWER, _ANSWER * 2], _modbus_client, (ReplyMismatch, DeviceException)),
    "modbus-server": FuzzTarget(
        lambda: [struct.pack(">HHHBBHH", 1, 0, 6, 1, 3, 0, 9), struct.pack(">HHHBBHHBH", 2, 0, 9, 1, 16, 0, 1, 2, 7)],
        _server(framing.read_headed),
        (),
    ),
    "rtu-client": FuzzTarget(
        lambda: [b"\1\3\4\0\1\0\2" + rtu.crc(b"\1\3\4\0\1\0\2"), b"\1\x83\2" + rtu.crc(b"\1\x83\2")],
        _rtu_client,
        (ReplyMismatch, DeviceException),
    ),
    "rtu-server": FuzzTarget(
        lambda: [
            b"\1\3\0\0\0\2" + rtu.crc(b"\1\3\0\0\0\2"),
            b"\1\x10\0\0\0\1\2\0\7" + rtu.crc(b"\1\x10\0\0\0\1\2\0\7"),
        ],
        _server(framing.read_rtu),
        (),
    ),
    "isotp": FuzzTarget(lambda: [b"\3\x41\x0c\x1aAAAA", b"\x10\x14ABCDEF\x21GHIJKLM\x22NOPQRST"], _isotp, ()),
    "j1939": FuzzTarget(
        lambda: [b"\x20\x0e\0\2\xff\xca\xfe\0\1ABCDEFG\2HIJKLMN", b"\x10\x0e\0\2\xff\xca\xfe\0\1ABCDEFG\2HIJKLMN"],
        _j1939,
        (),
    ),
    "canopen-sdo": FuzzTarget(
        lambda: [b"\x4b\1\x20\1\7\0\0\0", b"\x41\1\x20\1\x0a\0\0\0\0ABCDEFG\x19HIJ\0\0\0\0"],
        _sdo(lambda: upload(ObjectPlace(0x2001, 1))),
        (DriverError,),
    ),
    "canopen-sdo-block": FuzzTarget(
        lambda: [b"\xc6\1\x20\1\x0a\0\0\0\1ABCDEFG\x82HIJ\0\0\0\0\xd1\x8c\x6f\0\0\0\0\0"],
        _sdo(lambda: block_upload(ObjectPlace(0x2001, 1))),
        (DriverError,),
    ),
    "canopen-pdo": FuzzTarget(lambda: [b"\x10\x10\x08\x18ABCDEFGH"], _pdo, (DriverError,)),
    "canopen-emcy": FuzzTarget(lambda: [b"\x10\x42\x09ABCDE\0\0\0\0\0\0\0\0"], _emergency, ()),
    "eds": FuzzTarget(
        _files("config/decanter.eds"),
        _of_text(lambda text: (sheet := parse_sheet(text, 1, "x.eds")).pdos("T") + sheet.pdos("R")),
        (DriverError,),
    ),
    "dbc": FuzzTarget(lambda: [DBC], _of_file("x.dbc", _dbc), (DriverError,)),
    "log-candump": FuzzTarget(
        lambda: [b"(1700000000.0) can0 123#1122334455667788\n(1700000000.1) can0 00000123##1AABB\n"],
        _can_log("candump"),
        (),
    ),
    "log-asc": FuzzTarget(
        lambda: [b"date Mon Jan 1 10:00:00 2024\nbase hex timestamps absolute\n 0.1 1 123 Rx d 2 11 22\n"],
        _can_log("asc"),
        (),
    ),
    "log-trc": FuzzTarget(lambda: [b";$FILEVERSION=1.1\n 1) 10.0 Rx 0123 2 11 22\n"], _can_log("trc"), ()),
    "log-csv": FuzzTarget(
        lambda: [b"timestamp,arbitration_id,extended,remote,error,dlc,data\n1.5,0x123,0,0,0,2,ESI=\n"],
        _can_log("csv"),
        (),
    ),
    "log-blf": FuzzTarget(lambda: [b"LOGG" + bytes(140) + b"LOBJ" + bytes(40)], _can_log("blf"), ()),
    "csv": FuzzTarget(
        lambda: [CSV],
        _of_file("x.csv", lambda path: load_traces(path, load_map(ROOT / "config/traces/decanter.toml"))),
        (TraceError,),
    ),
    "column-map": FuzzTarget(_files("config/traces/*.toml"), _of_file("map.toml", load_map), (ValueError,)),
    "device-toml": FuzzTarget(
        _files("config/devices/*.toml"), _of_file("device.toml", read_device_file), (ConfigError,)
    ),
    "plant-toml": FuzzTarget(_texts(PLANT), _of_file("plant.toml", load_config), (ConfigError,)),
    "dot": FuzzTarget(_texts(DOT), _of_text(parse_source), (ArtefactError,)),
    "report": FuzzTarget(_texts(REPORT), _of_text(parse_report), (ArtefactError,)),
    "flow-file": FuzzTarget(_texts(*FLOWS), _of_text(parse_flow_file), (ArtefactError,)),
    "histogram": FuzzTarget(_texts("k_0:\n0.1\n0.2\nmu_0:\n25.5\n"), _of_text(parse_histogram), (ArtefactError,)),
    "model-json": FuzzTarget(lambda: [_model().encode()], _of_text(parse_model), (ArtefactError,)),
    "xlsx": FuzzTarget(
        lambda: [workbook()],
        _of_file("x.xlsx", lambda path: read_sheet(path, COLUMNS, ("name", "address"))),
        (ListError,),
    ),
    "query": FuzzTarget(_texts(*QUERIES), _of_text(lambda text: parse_query(text, two_modes())), (QueryError,)),
    "control-line": FuzzTarget(_texts(*REQUESTS), lambda data, _: json_lines.parsed(data), (json_lines.NoObject,)),
}
"""Every target; a new one is a row here."""
