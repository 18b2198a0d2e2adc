"""The gateway as a service among others: one historian, one gateway; a stop that the PLC hears; a disk that is full."""

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from gateway.store.read_back import reading
from sim.plc.record.recording import read_recording
from tests.rig.pair import Gateway, Rig, end, make_rig, restless_trace

PERIOD = 0.1
FULL = 2 | 4 | 8 | 16
"""Inputs, location, forecast, model. The restless trace follows no model: its zone is red, and bit 0 stays clear."""
STOP_S = 5.0


def good(rig: Rig, gateway: Gateway, blocks: int) -> None:
    """Wait until the PLC has accepted more than so many blocks, with a prediction that it may use."""
    gateway.wait_for(
        lambda status: (
            status["writeback"].get("accepted", 0) > blocks and status["writeback"]["last_validity"] & FULL == FULL
        )
    )


def test_a_second_gateway_on_one_historian_is_refused_in_one_sentence_and_the_first_goes_on(tmp_path: Path) -> None:
    rig = make_rig(tmp_path, restless_trace(60.0), period=PERIOD)
    with rig.plc() as plc, rig.gateway(plc) as first:
        good(rig, first, 5)
        second = rig.start_gateway(plc)
        try:
            _, words = second.process.communicate(timeout=120.0)
        finally:
            end(second.process)
        assert second.process.returncode == 2
        (sentence,) = words.splitlines()
        assert sentence.startswith("decanter: ") and "another gateway is running on this historian" in sentence
        before = first.wait_for(lambda status: bool(status["scan"]["count"]))["writeback"]["accepted"]
        good(rig, first, before + 5)
        assert first.stop()[0] == 0


def test_a_graceful_stop_leaves_validity_0_in_the_plc_and_exits_0(tmp_path: Path) -> None:
    rig = make_rig(tmp_path, restless_trace(60.0), period=PERIOD)
    with rig.plc() as plc, rig.gateway(plc) as gateway:
        good(rig, gateway, 10)
        code, seconds = gateway.stop()
        assert (code, gateway.words()) == (0, "")
        assert seconds < STOP_S
        said = plc.order("status")
    blocks = read_recording(rig.recording).blocks
    assert blocks[-1].fields is not None and blocks[-2].fields is not None
    assert (blocks[-1].fields["validity"], int(blocks[-2].fields["validity"]) & FULL) == (0.0, FULL)
    assert blocks[-1].accepted and said["usable"] is False
    with reading(rig.historian) as connection:
        rows = connection.execute("SELECT what FROM audit ORDER BY id DESC LIMIT 1").fetchall()
        newest = connection.execute("SELECT validity, verdict FROM writes ORDER BY id DESC LIMIT 1").fetchall()
    assert rows == [("validity 0: written",)] and newest == [(0, "written")]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 3 MB, or a skip where this user may not mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(place)]
    done = subprocess.run(command, capture_output=True, text=True, check=False) if os.geteuid() == 0 else None
    if done is None or done.returncode:
        pytest.skip(f"cannot mount a small file system: {done.stderr.strip() if done else 'not root'}")
    try:
        yield place
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


def fill(disk: Path) -> Path:
    """Take all the room there is."""
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as stream:
        try:
            while True:
                stream.write(b"\0" * 4096)
        except OSError:
            return filler


def test_a_full_disk_stops_no_scan_holds_back_writes_without_a_record_and_costs_no_row(
    tmp_path: Path, small_disk: Path
) -> None:
    rig = make_rig(tmp_path, restless_trace(90.0), period=PERIOD, records=small_disk)
    with rig.plc() as plc, rig.gateway(plc) as gateway:
        good(rig, gateway, 10)
        filler = fill(small_disk)
        full = gateway.wait_for(lambda status: bool(status["historian"]["failure"]))
        assert "make room" in full["historian"]["failure"] and str(rig.historian) in full["historian"]["failure"]
        on = gateway.wait_for(lambda status: status["scan"]["count"] > full["scan"]["count"] + 20)
        assert on["historian"]["failure"] and "no audit record could be kept" in on["writeback"]["last_reason"]
        filler.unlink()
        gateway.wait_for(lambda status: not status["historian"]["failure"])
        good(rig, gateway, on["writeback"]["accepted"] + 5)
        last = gateway.status
        assert (gateway.stop()[0], last["failures"], last["historian"]["dropped"]) == (0, 0, 0)
        accepted = plc.order("status")["accepted"]
    with reading(rig.historian) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        verdicts = [row[0] for row in connection.execute("SELECT verdict FROM writes ORDER BY id")]
    assert verdicts.count("written") == accepted and verdicts.count("not permitted") > 10, "no row is lost"


def test_a_gateway_that_must_stop_with_a_full_disk_ends_in_time_and_says_what_it_could_not_keep(
    tmp_path: Path, small_disk: Path
) -> None:
    rig = make_rig(tmp_path, restless_trace(60.0), period=PERIOD, records=small_disk)
    with rig.plc() as plc, rig.gateway(plc) as gateway:
        good(rig, gateway, 10)
        fill(small_disk)
        gateway.wait_for(lambda status: bool(status["historian"]["failure"]))
        code, _ = gateway.stop()
        assert code == 1
        assert "records could not be stored" in gateway.words()
        assert int(plc.order("status")["block"]["validity"]) == 0
