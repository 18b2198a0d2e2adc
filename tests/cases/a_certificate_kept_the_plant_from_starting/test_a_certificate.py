"""A damaged or missing certificate of one machine's Modbus TLS link refused the start of the whole plant.

Only the plant file and the device files may. The machine is without its device, with an alarm that says why, until
the file is whole; the others are watched.
"""

import asyncio
import shutil
import ssl
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

from drivers.driver import Driver
from drivers.errors import DriverError
from drivers.modbus.tls import FILES, load_identity
from gateway.plant.app import run
from gateway.plant.device import make_driver
from gateway.settings import Config, load_plant
from tests.drivers import certified
from tests.gateway.support import MAP, TEMPERATURE, Bench, JumpClock

SCANS = 12
DAMAGES: dict[str, Callable[[bytes], bytes | None]] = {
    "missing": lambda _: None,
    "emptied": lambda _: b"",
    "cut": lambda data: data[: len(data) // 2],
    "flipped": lambda data: data[:30] + bytes(byte ^ 2 for byte in data[30:40]) + data[40:],
    "binary": lambda data: b"\xff\xfe\0" + data[3:],
}


def damage(path: Path, change: Callable[[bytes], bytes | None]) -> None:
    if (data := change(path.read_bytes())) is None:
        path.unlink()
    else:
        path.write_bytes(data)


def plant_in(folder: Path) -> tuple[Config, ...]:
    text = MAP.read_text(encoding="utf-8")
    head, separator, rest = text.partition("[device]\n")
    (folder / "secured.toml").write_text(
        f'{head}{separator}transport = "tls"\ncertificates = "certificates"\n{rest}', encoding="utf-8"
    )
    # The first machine of a plant begins at once, the second some real time later.
    machines = [
        '[[machine]]\nname = "secured"\ndevice = { file = "secured.toml", port = 1 }\n',
        f'[[machine]]\nname = "other"\ndevice = {{ file = "{MAP}" }}\n',
    ]
    (folder / "plant.toml").write_text(
        '[historian]\npath = "records/h.sqlite"\n[log]\npath = "gateway.jsonl"\n' + "".join(machines), encoding="utf-8"
    )
    return load_plant(folder / "plant.toml")


@pytest.mark.parametrize("change", DAMAGES)
@pytest.mark.parametrize("file", FILES)
async def test_the_others_are_watched_and_the_alarm_says_why(tmp_path: Path, file: str, change: str) -> None:
    certified.folder(tmp_path / "certificates")
    damage(tmp_path / "certificates" / file, DAMAGES[change])
    configs = plant_in(tmp_path)
    clock, stop = JumpClock(), asyncio.Event()
    bench = Bench(configs[1], clock, stop_after=SCANS)
    bench.plan[0] = {TEMPERATURE: 95.0}

    def driver_of(config: Config, *others: Any) -> Driver:
        return bench if config.machine == "other" else make_driver(config, *others)

    async def stopped() -> None:
        await bench.stop.wait()
        stop.set()

    with mock.patch("gateway.plant.fleet.make_driver", driver_of):
        stopping = asyncio.create_task(stopped())
        status = await asyncio.wait_for(run(*configs, clock=clock, stop=stop), 300.0)
        await stopping
    other, secured = (status["machines"][name] for name in ("other", "secured"))
    assert other["alarms"][f"over limit {TEMPERATURE}"] == "unacknowledged" and other["scan"]["count"] >= SCANS - 1
    assert secured["alarms"]["link"] == "unacknowledged", (secured["scan"], secured["link"])
    reasons = {value["reason"] for value in secured["values"].values()}
    assert any(str(tmp_path / "certificates") in reason for reason in reasons), reasons


def test_whatever_byte_is_damaged_the_certificates_are_refused_in_one_sentence_or_used(tmp_path: Path) -> None:
    folder = certified.folder(tmp_path / "c")
    whole, refused = tmp_path / "whole", 0
    shutil.copytree(folder, whole)
    for name in FILES:
        data = (whole / name).read_bytes()
        for place in range(0, len(data), 7):
            (folder / name).write_bytes(data[:place] + bytes([data[place] ^ 1 << place % 7]) + data[place + 1 :])
            try:
                assert isinstance(load_identity(folder).context, ssl.SSLContext)
            except DriverError as error:
                refused += 1
                assert "\n" not in str(error)
        (folder / name).write_bytes(data)
    assert refused > 40
