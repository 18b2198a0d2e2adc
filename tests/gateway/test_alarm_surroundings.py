"""Alarms about what a machine relies on: link, disk, certificates, messages; and each kind is watched by something."""

import datetime as dt
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from gateway.clock_sync import clock_error
from gateway.machine.alarms import make_conditions
from gateway.network.certificates import make_all, make_application, remaining_days
from gateway.plant.status import snapshot
from gateway.settings import ALARM_KINDS
from gateway.settings.config import Config, load_config
from tests.gateway.support import EPOCH, MAP, TEMPERATURE, config_in, plant_file, two_modes
from tests.gateway.test_alarm_desk import OTHER, QUICK, Stand, standing

BROKER = '[[northbound.mqtt]]\nname = "it"\nhost = "127.0.0.1"\ntls = false\n'
DAY = dt.timedelta(days=1)
BEGIN = dt.datetime.fromtimestamp(EPOCH, dt.UTC)


def over_tls(folder: Path, text: str, days: int, **keys: Any) -> Config:
    """The configuration of a PLC over TLS, with certificates that run out so many days after the begin."""
    # Made a hundred days ago.
    make_all(folder / "tls", hosts=["127.0.0.1"], days=100 + days, now=BEGIN - 100 * DAY)
    device = folder / "device.toml"
    own = f'driver = "modbus"\ntransport = "tls"\ncertificates = "{folder}/tls"\n'
    device.write_text(MAP.read_text().replace('driver = "modbus"\n', own))
    return load_config(plant_file(folder, text, device=device, **keys), {"writeback.mode": "shadow"})


async def looked(stand: Stand) -> None:
    """Scan until disk and certificates were looked at, and once more."""
    await stand.scan()
    await stand.machine.surroundings.close()
    await stand.scan()


async def test_a_link_without_a_good_reading_is_an_alarm_and_ends_with_the_next_one(tmp_path: Path) -> None:
    async with standing(config_in(tmp_path, QUICK)) as stand:
        await stand.scan()
        gone = dict.fromkeys(stand.values)
        await stand.scan(**gone)
        await stand.scan(9.0)
        assert stand.state("link") == "normal", "not before its delay"
        await stand.scan(2.0)
        assert stand.state("link") == "unacknowledged"
        await stand.scan(**{TEMPERATURE: 25.0, OTHER: 25.0, "AcknowledgeBits": 0})
        assert stand.state("link") == "returned unacknowledged"


@pytest.mark.parametrize(("days", "state"), [(31, "normal"), (29, "unacknowledged"), (-1, "unacknowledged")])
async def test_a_certificate_that_runs_out_is_an_alarm_in_time(days: int, state: str, tmp_path: Path) -> None:
    async with standing(over_tls(tmp_path, QUICK, days)) as stand:
        await looked(stand)
        assert stand.state("certificate") == state


def test_a_certificate_that_cannot_be_read_is_left_out(tmp_path: Path) -> None:
    make_all(tmp_path / "tls", hosts=["127.0.0.1"], days=10, now=BEGIN)
    (tmp_path / "tls" / "ca.pem").write_text("no certificate")
    found = remaining_days(tmp_path / "tls", EPOCH)
    assert len(found) == 2 and all(9.9 < days < 10.1 for days in found)
    assert remaining_days(tmp_path / "nothing", EPOCH) == []


async def test_a_disk_that_is_nearly_full_is_an_alarm(tmp_path: Path) -> None:
    async with standing(config_in(tmp_path, QUICK + "disk_mb = 1e12\n")) as stand:
        await looked(stand)
        assert stand.state("disk") == "unacknowledged"


@pytest.mark.parametrize(("error", "state"), [(0.02, "normal"), (None, "normal"), (math.inf, "unacknowledged")])
async def test_a_clock_that_no_time_server_steers_is_an_alarm_after_an_hour(
    error: float | None, state: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("gateway.machine.trust.clock_error", lambda: error)
    async with standing(config_in(tmp_path, QUICK)) as stand:
        await looked(stand)
        assert snapshot(stand.machine).clock["synchronised"] == {0.02: True, None: None, math.inf: False}[error]
        assert stand.state("clock not steered") == "normal", "a server is given time to be found"
        await stand.scan(3601.0)
        assert stand.state("clock not steered") == state


def test_the_kernel_says_what_timedatectl_says_of_the_clock() -> None:
    if shutil.which("timedatectl") is None:
        pytest.skip("needs timedatectl (apt-get install systemd)")
    said = subprocess.run(
        ["timedatectl", "show", "-p", "NTPSynchronized", "--value"], capture_output=True, text=True, check=False
    )
    if said.returncode:
        pytest.skip(f"there is no timedated to ask here: {said.stderr.strip()}")
    error = clock_error()
    assert error is not None and math.isfinite(error) == (said.stdout.strip() == "yes")


async def test_messages_that_are_not_delivered_are_an_alarm(tmp_path: Path) -> None:
    text = QUICK + '[[notify.to]]\nname = "shift"\nwebhook = "https://example.com/x"\n'
    async with standing(config_in(tmp_path, text)) as stand:
        await stand.scan()
        stand.machine.common.undelivered = lambda: "shift: the web hook cannot be reached"
        await stand.scan()
        assert stand.state("notification") == "unacknowledged"


@pytest.mark.parametrize(("days", "state"), [(31, "normal"), (29, "unacknowledged")])
async def test_the_certificate_of_the_opc_ua_server_is_watched_too(days: int, state: str, tmp_path: Path) -> None:
    make_application(tmp_path / "opcua", hosts=["127.0.0.1"], days=100 + days, now=BEGIN - 100 * DAY)
    server = '[northbound.opcua]\ncertificates = "opcua"\n'
    async with standing(config_in(tmp_path, QUICK + server)) as stand:
        assert "certificate" not in stand.machine.alarms.alarms, "nothing is served"
    async with standing(config_in(tmp_path, QUICK + server + "port = 0\n"), at=1.0) as stand:
        await looked(stand)
        assert stand.state("certificate") == state


async def test_a_broker_out_of_reach_is_an_alarm_once_it_was_so_for_the_stated_time(tmp_path: Path) -> None:
    text = QUICK + BROKER + '[[alarm]]\nname = "northbound"\non_delay = 60.0\n'
    async with standing(config_in(tmp_path, text)) as stand:
        await stand.scan()
        stand.machine.common.unreached = lambda: "it: 127.0.0.1:1883 cannot be reached: Connection refused"
        await stand.scan()
        await stand.scan(59.0)
        assert stand.state("northbound") == "normal"
        await stand.scan(1.0)
        assert stand.state("northbound") == "unacknowledged"
        stand.machine.common.unreached = lambda: ""
        await stand.scan()
        assert stand.state("northbound") == "returned unacknowledged"


async def test_every_kind_of_alarm_can_be_had_and_each_is_looked_at_in_a_scan(tmp_path: Path) -> None:
    text = QUICK.replace("sensors = false", "sensors = true").replace("trend = false", "trend = 300")
    text += '[[notify.to]]\nname = "a"\nwebhook = "https://example.com/x"\n' + BROKER
    config = over_tls(tmp_path, text, 100, model=two_modes())
    conditions = make_conditions(config, config.watched_temperatures, complains=True)
    assert {condition.kind for condition in conditions.values()} == set(ALARM_KINDS)
    for condition in conditions.values():
        kind = ALARM_KINDS[condition.kind]
        assert (condition.priority, condition.bit, condition.consequence) == (kind.priority, kind.bit, kind.consequence)
        assert condition.response and "{" not in condition.response
    async with standing(config) as stand:
        board, seen = stand.machine.alarms, set[str]()
        step = board._step

        def noted(values, now, before):  # type: ignore[no-untyped-def]
            seen.update(values)
            step(values, now, before)

        board._step = noted  # type: ignore[method-assign]
        # A reading that does not move, jumps or fails says something of every watch but that of the twins.
        for second in range(5):
            await stand.scan(**{TEMPERATURE: 25.0 + 0.1 * second})
        assert set(board.conditions) <= seen | {f"sensor drifting {TEMPERATURE}"}


async def test_an_alarm_that_is_switched_off_is_not_there_and_nothing_fails(tmp_path: Path) -> None:
    rows = "".join(f'[[alarm]]\nname = "{name}"\nenabled = false\n' for name in ALARM_KINDS)
    async with standing(config_in(tmp_path, QUICK + rows)) as stand:
        await stand.scan(**{TEMPERATURE: 90.0})
        await looked(stand)
        assert stand.machine.alarms.alarms == {} and stand.machine.alarms.word(TEMPERATURE) == 0
