"""What `probe` finds of devices with habits: the setting that reads them, who they are, and both put into the file."""

import socket
import struct
import tomllib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from drivers.errors import DeviceException, LinkDown, ReplyTimeout
from drivers.survey import ReadWords
from gateway.commission import probe
from tests.commission.bench import Handler, answer, plc, server

DEVICE = """# The device of this plant.
[device]
name = "d"
driver = "modbus"

[[tags]]
name = "T"
address = "holding:3"   # kept
"""


def take(link: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = link.recv(size - len(data))
        if not part:
            raise OSError
        data += part
    return data


def device(
    *,
    transaction: int | None = None,
    unit: int | None = None,
    beside: int | None = None,
    silences: int = 0,
    vendor: bytes = b"Maker",
    answers: int = 1000,
) -> Handler:
    """A device whose registers hold their own numbers, and which answers so often a connection, in a way of its own.

    `beside`: a frame of this unit always comes first; `silences`: a gateway says so often that its unit is silent.
    """

    told = 0

    def handle(link: socket.socket) -> None:
        nonlocal told
        for _ in range(answers):
            head = take(link, 7)
            pdu = take(link, int.from_bytes(head[4:6], "big") - 1)
            if told < silences:
                told, reply = told + 1, bytes((pdu[0] | 0x80, 11))
            elif pdu[0] == 43:
                # its vendor and its revision
                reply = bytes((43, 14, 1, 1, 0, 0, 2, 0, len(vendor))) + vendor + b"\x02\x02v3"
            elif pdu[0] in (3, 4):
                start, count = struct.unpack(">HH", pdu[1:])
                reply = struct.pack(f">BB{count}H", pdu[0], 2 * count, *range(start, start + count))
            else:
                reply = bytes((pdu[0] | 0x80, 1))
            number = head[:2] if transaction is None else transaction.to_bytes(2, "big")
            own = head[6:7] if unit is None else bytes((unit,))
            if beside is not None:
                link.sendall(head[:2] + b"\0\0\0\5" + bytes((beside, 3, 2, 0, 0)))
            link.sendall(number + b"\0\0" + (len(reply) + 1).to_bytes(2, "big") + own + reply)
        link.close()

    return handle


@pytest.mark.parametrize(
    ("handle", "habits"),
    [
        (device(transaction=0), {"transaction_id": "any"}),
        (device(unit=255), {"answers_as": 255}),
        (device(transaction=9, unit=0), {"transaction_id": "any", "answers_as": 0}),
        (device(beside=9), {}),
        (device(silences=2), {}),
        (device(), {}),
    ],
    ids=["another id", "another unit", "both", "another unit's first", "silent behind a gateway at first", "none"],
)
def test_the_setting_that_reads_a_device_is_found_said_and_written(
    handle: Handler, habits: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # None of these is silent after connecting: a first answer that takes long is this computer's, which is busy.
    monkeypatch.setattr(probe, "UNREQUESTED_WAIT_S", 60.0)
    file = tmp_path / "d.toml"
    file.write_text(DEVICE)
    with server(handle) as port:
        at = "--host", f"127.0.0.1:{port}", "--device", file
        data = answer(tmp_path, "probe", *at)
        assert data["exit"] == 0 and data.get("habits", {}) == habits
        shown = plc(tmp_path, "probe", *at, "--write", "--pin").output
        assert all(key in shown for key in habits) and "written" in shown
        written = tomllib.loads(file.read_text())["device"]
        assert written == {"name": "d", "driver": "modbus", **habits, "identity": {"vendor": "Maker"}}
        assert "# kept" in file.read_text()
        assert answer(tmp_path, "read", "T", *at)["readings"][0]["value"] == 3


class Scripted:
    """A device of which each connection shows its own first answer: so many seconds, or another transaction id."""

    target = SimpleNamespace(
        capabilities=SimpleNamespace(registers=True),
        settings={},
        kind="modbus",
        place="a line",
        driver="modbus",
        tags=(),
    )
    evidence = SimpleNamespace(greeting=b"")

    def __init__(self, *firsts: float | str) -> None:
        self.firsts = iter(firsts)
        self.asked: list[dict[str, Any]] = []

    @asynccontextmanager
    async def registers(self, *, connect_timeout: float, **habits: Any) -> AsyncIterator["Scripted"]:
        self.asked.append(habits)
        self.first = next(self.firsts)
        if self.first == "refused":
            raise LinkDown("refused: it serves one client")
        yield self

    async def read(self, *_: object) -> ReadWords:
        if isinstance(self.first, str) and not self.asked[-1]:
            raise ReplyTimeout("another id", remedy={"transaction_id": "any"})
        return ReadWords((0,), 0.0)

    async def identity(self) -> dict[str, str]:
        return {}

    async def server_id(self) -> str:
        return ""

    def statistics(self) -> dict[str, float]:
        return {"seconds_to_first": 0.0 if isinstance(self.first, str) else self.first, "foreign_replies": 1}


@pytest.mark.parametrize(
    ("firsts", "habits"),
    [
        ((1000.0, 900.0), {"pause_after_connect": 1000.0}),
        ((1000.0, 0.0), {}),
        (("another", "another", "another"), {"transaction_id": "any"}),
        (("another", "another", 0.0), {}),
    ],
    ids=["quiet", "one slow answer", "another id", "one late answer"],
)
async def test_a_habit_is_what_two_connections_show(
    firsts: tuple[float | str, ...], habits: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probe, "mention_gateway", lambda site: None)
    site = Scripted(*firsts)
    result = await probe.probe_device(cast(Any, site))
    assert not result.complaint and result.data.get("habits", {}) == habits
    assert next(site.firsts, None) is None
    told = next(step for step in result.data["steps"] if step["step"] == "habit")
    assert (told["state"] == "ok") is not bool(habits) and ("nothing is set" in told["sentence"]) is not bool(habits)


@pytest.mark.parametrize("firsts", [("another", 0.0, "refused"), (1000.0, "refused")], ids=["an id", "a pause"])
async def test_a_connection_that_fails_confirms_no_habit(
    firsts: tuple[float | str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probe, "mention_gateway", lambda site: None)
    result = await probe.probe_device(cast(Any, Scripted(*firsts)))
    assert not result.complaint and "habits" not in result.data
    told = next(step for step in result.data["steps"] if step["step"] == "habit")
    assert "failed (refused: it serves one client)" in told["sentence"] and "nothing is set" in told["sentence"]


async def test_a_first_refusal_took_what_the_survey_says(monkeypatch: pytest.MonkeyPatch) -> None:
    class Refusing(Scripted):
        async def read(self, *_: object) -> ReadWords:
            raise DeviceException(2, "refused")

    monkeypatch.setattr(probe, "mention_gateway", lambda site: None)
    result = await probe.probe_device(cast(Any, Refusing(0.02)))
    told = next(step["sentence"] for step in result.data["steps"] if step["step"] == "modbus")
    assert told == "unit 1 answers in 20.0 ms, with a refusal: refused"


async def test_the_round_trip_counts_what_was_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    class Forgetful(Scripted):
        asked_for = 0

        async def read(self, *place: object) -> ReadWords:
            self.asked_for += 1
            if self.asked_for > 5 and self.asked_for % 3:
                raise ReplyTimeout("nothing came")
            return await super().read(*place)

    monkeypatch.setattr(probe, "mention_gateway", lambda site: None)
    result = await probe.probe_device(cast(Any, Forgetful(0.0)))
    told = {step["step"]: step["sentence"] for step in result.data["steps"]}
    answered = int(told["round trip"].split()[0])
    assert answered < probe.ROUND_TRIPS and told["answers"].startswith(f"10 of {10 + answered} requests")


def test_a_device_that_hangs_up_after_some_answers_is_probed_to_the_end(tmp_path: Path) -> None:
    with server(device(answers=4)) as port:
        data = answer(tmp_path, "probe", "--host", "127.0.0.1", "--port", port)
    told = {step["step"]: step for step in data["steps"]}
    assert data["exit"] == 0 and "requests brought no answer" in told["answers"]["sentence"]
    assert told["answers"]["state"] == "warning" and told["round trip"]["sentence"].startswith("10 requests")


def test_another_device_than_the_pinned_one_is_found_by_every_command(tmp_path: Path) -> None:
    file = tmp_path / "d.toml"
    file.write_text(DEVICE.replace('"modbus"\n', '"modbus"\nidentity = { vendor = "Maker" }\n'))
    with server(device(vendor=b"Other")) as port:
        at = "--device", file, "--host", "127.0.0.1", "--port", port
        for command in (("probe",), ("read", "T"), ("check",)):
            told = plc(tmp_path, *command, *at)
            assert told.exit_code == 3 and "another device answers" in told.output and "'Other'" in told.output
        before = file.read_text()
        assert plc(tmp_path, "probe", *at, "--write", "--pin").exit_code == 3 and file.read_text() == before


def test_what_is_written_needs_a_file() -> None:
    for options in (("--write",), ("--pin",)):
        assert plc(Path(), "probe", "--host", "127.0.0.1", *options).exit_code == 2
