"""`plan`, `check`, `verify`, `soak` and `replay` against the software PLC, over several links."""

import csv
import json
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.can.bus.hub import Hub
from gateway.commission.files.recording import read_recording
from gateway.commission.soak import recommend_period
from sim.artefacts.model_json import model_text
from sim.lab.recordings.trace_file import write_trace
from tests.commission.bench import answer, at, force, free_port, plc
from tests.plc.bench import DECANTER, ROOT, Process, running, wait_until
from tests.rig.pair import known_model, restless_trace

ANALOGUE = (
    *("Assorbimento", "Coppia", "Differenziale", "LivelloVibrazioni", "TCuscinettiRiduttore"),
    *("TCuscinettiAlimentazione", "TFango", "VelocitaPompa", "TAmbiente"),
)
CANOPEN, CAN = ROOT / "config/devices/decanter_canopen.toml", ROOT / "config/devices/decanter_can.toml"


@pytest.fixture(scope="module")
def device(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Process, Path]]:
    hub = tmp_path_factory.mktemp("bus") / "can.hub"
    options = ["--canopen", CANOPEN, "--can", CAN, "--can-interface", "hub", "--can-channel", hub]
    with Hub(hub), running(*options) as process:
        for name in ANALOGUE:
            force(process, name, 40.0)
        yield process, hub


def links(device: tuple[Process, Path]) -> dict[str, tuple[object, ...]]:
    process, hub = device
    bus = ("--interface", "hub", "--channel", hub)
    return {
        "modbus": ("--device", DECANTER, *at(process)),
        "canopen": ("--device", CANOPEN, *bus),
        "can": ("--device", CAN, *bus),
    }


# ---------------------------------------------------------------- plan


def test_a_plan_shows_each_request_with_both_numbers_and_the_worst_case(tmp_path: Path) -> None:
    data = answer(tmp_path, "plan", "--device", DECANTER, "--host", "10.0.0.1", "--timeout", 0.2, "--set",
                  "max_registers=11", "--set", "max_write_registers=100")  # fmt: skip
    assert data["ok"], data
    first, second, third = data["requests"]  # the third: what the PLC answers the second block with
    assert (first["place"], first["count"], first["reference"]) == ("holding:100", 11, "40101-40111")
    assert (second["place"], second["count"]) == ("holding:111", 11)
    assert (third["place"], third["count"]) == ("holding:122", 8)
    assert data["worst_read_s"] == pytest.approx(0.6)
    assert [one["kind"] for one in data["writes"]] == 2 * ["write", "read back", "read back", "read back"]
    assert {one["place"] for one in data["writes"] if one["kind"] == "write"} == {"holding:400", "holding:430"}
    assert data["worst_cycle_s"] == pytest.approx(0.6 + 2 * 4 * 0.2)


def test_a_scan_that_can_take_longer_than_its_period_fails_the_check_and_says_what_would_fit(tmp_path: Path) -> None:
    where = ("--device", DECANTER, "--host", "10.0.0.1", "--timeout", 0.6, "--set", "max_registers=11")
    where = (*where, "--set", "max_write_registers=100")
    result = plc(tmp_path, "plan", *where, "--period", 1.0)
    assert result.exit_code == 1
    assert "1.8 s" in result.stderr and "scan.period" in result.stderr and "timeout to 0.33 s" in result.stderr


def test_a_serial_line_needs_the_time_of_its_bytes_besides(tmp_path: Path) -> None:
    where = ("--device", DECANTER, "--serial", "/dev/ttyS9", "--timeout", 0.2, "--set", "longest_reply=0.2")
    slow = answer(tmp_path, "plan", *where, "--baud", 1200)["worst_read_s"]
    fast = answer(tmp_path, "plan", *where, "--baud", 115_200)["worst_read_s"]
    assert slow - fast == pytest.approx((8 + 5 + 2 * 30) * 11 * (1 / 1200 - 1 / 115_200), rel=1e-6)


def test_tags_that_share_registers_are_named(tmp_path: Path) -> None:
    path = tmp_path / "plc.toml"
    path.write_text(
        '[device]\nname = "a"\ndriver = "modbus"\n[[tags]]\nname = "A"\naddress = "holding:1"\ndtype = "float32"\n'
        '[[tags]]\nname = "B"\naddress = "holding:2"\n',
        encoding="utf-8",
    )
    data = answer(tmp_path, "plan", "--device", path, "--host", "10.0.0.1")
    assert data["exit"] == 1 and "A and B overlap" in data["problems"][0]


def test_a_period_that_comes_to_nothing_is_said(tmp_path: Path) -> None:
    path = tmp_path / "plc.toml"
    head = '[device]\nname = "a"\ndriver = "modbus"\nhost = "10.0.0.1"\nclose_between_scans = true\n'
    tags = '[[tags]]\nname = "A"\naddress = "holding:1"\nperiod = 60\n[[tags]]\nname = "B"\naddress = "holding:2"\n'
    path.write_text(head + tags, encoding="utf-8")
    (note,) = answer(tmp_path, "plan", "--device", path)["notes"]
    assert note.startswith("period: A is read with every scan all the same") and "give identity" in note
    data = answer(tmp_path, "check", "--device", path, "--offline")
    assert data["ok"] and [one["sentence"] for one in data["steps"] if one["state"] == "warning"].count(note) == 1
    for text in (head + '[device.identity]\n"server id" = "x"\n' + tags, head.replace("true", "false") + tags):
        path.write_text(text, encoding="utf-8")
        assert not answer(tmp_path, "plan", "--device", path)["notes"]


@pytest.mark.parametrize("link", ["canopen", "can"])
def test_a_device_that_speaks_by_itself_shows_its_messages(
    device: tuple[Process, Path], tmp_path: Path, link: str
) -> None:
    data = answer(tmp_path, "plan", *links(device)[link])
    assert data["ok"] and any("TCuscinettiRiduttore" in line for line in data["sentences"])


# ---------------------------------------------------------------- check


@pytest.mark.parametrize("link", ["modbus", "canopen", "can"])
def test_a_plant_in_order_passes_over_every_link(device: tuple[Process, Path], tmp_path: Path, link: str) -> None:
    data = answer(tmp_path, "check", *links(device)[link])
    assert data["ok"], data
    states = {step["step"]: step["state"] for step in data["steps"]}
    assert states["reading"] == states["heartbeat"] == states["files"] == "ok"
    assert len(data["readings"]) == 33, "25, and eight by which the PLC answers the second block"


def test_a_refused_tag_and_a_standing_heartbeat_fail_the_check(tmp_path: Path) -> None:
    with running() as process:
        force(process, "Coppia", 40.0)
        process.fault("illegal_register", registers=["holding:102"])
        process.fault("frozen", tags=["PlcHeartbeat"])
        data = answer(tmp_path, "check", "--device", DECANTER, "--timeout", 2.0, *at(process))
    assert data["exit"] == 1, data["steps"]
    failed = [step["sentence"] for step in data["steps"] if step["state"] == "failed"]
    assert any("Coppia" in sentence for sentence in failed) and any("PlcHeartbeat stood at" in one for one in failed)
    off = [step["sentence"] for step in data["steps"] if step["state"] == "warning"]
    assert any("TFango" in sentence and "not available" in sentence for sentence in off)


def test_without_a_plc_the_check_cannot_connect_and_offline_it_need_not(tmp_path: Path) -> None:
    where = ("--device", DECANTER, "--host", "127.0.0.1", "--port", free_port())
    assert plc(tmp_path, "check", *where).exit_code == 3
    assert plc(tmp_path, "check", "--offline", *where).exit_code == 0


# ---------------------------------------------------------------- verify


def hmi(folder: Path, *rows: tuple[str, str]) -> Path:
    path = folder / "hmi.csv"
    with path.open("w", encoding="utf-8", newline="") as stream:
        csv.writer(stream, delimiter=";").writerows([("Tag", "Valore HMI"), *rows])
    return path


@pytest.mark.parametrize("link", ["modbus", "canopen", "can"])
def test_two_lists_at_two_states_prove_a_number_and_a_flag(
    device: tuple[Process, Path], tmp_path: Path, link: str
) -> None:
    process, where = device[0], links(device)[link]
    only = ("--only", "TCuscinettiRiduttore", "--only", "MarciaDecanter")
    for temperature, flag in ((41.5, "1"), (63.2, "0")):
        force(process, "TCuscinettiRiduttore", temperature)
        force(process, "MarciaDecanter", flag == "1")
        wait_until(lambda wanted=temperature: process.order("values")["values"]["TCuscinettiRiduttore"] == wanted)
        shown = hmi(tmp_path, ("TCuscinettiRiduttore", f"{temperature}".replace(".", ",")), ("MarciaDecanter", flag))
        data = answer(tmp_path, "verify", "--against", shown, *only, *where)
        assert data["ok"], data
    assert (data["proved"], data["tags"], data["left"]) == (2, 2, {})


def test_a_reading_that_does_not_agree_fails_the_check_and_proves_nothing(
    device: tuple[Process, Path], tmp_path: Path
) -> None:
    force(device[0], "TCuscinettiRiduttore", 40.0)
    wait_until(lambda: device[0].order("values")["values"]["TCuscinettiRiduttore"] == 40.0)
    shown = hmi(tmp_path, ("TCuscinettiRiduttore", "44,0"))
    result = plc(tmp_path, "verify", "--against", shown, *links(device)["modbus"])
    assert result.exit_code == 1 and "TCuscinettiRiduttore: the HMI shows 44,0, the PLC has 40" in result.stderr
    data = answer(tmp_path, "verify", "--against", hmi(tmp_path, ("TCuscinettiRiduttore", "40,0")), "--complete",
                  *links(device)["modbus"])  # fmt: skip
    assert data["exit"] == 1 and data["left"]["TCuscinettiRiduttore"] == "compared at 40 only"


def test_readings_with_times_are_compared_with_what_was_recorded(tmp_path: Path) -> None:
    recording = tmp_path / "rec.csv"
    recording.write_text(
        "time,TCuscinettiRiduttore\n1700000000,40.1\n1700000010,50.0\n1700000020,60.3\n", encoding="utf-8"
    )
    shown = tmp_path / "hmi.csv"
    shown.write_text(
        "Tag,Value,Time\nTCuscinettiRiduttore,40.1,1700000030.5\nTCuscinettiRiduttore,60.3,1700000050\n",
        encoding="utf-8",
    )
    where = ("--readings", recording, "--device", DECANTER, "--host", "10.0.0.1", "--only", "TCuscinettiRiduttore")
    data = answer(tmp_path, "verify", "--against", shown, *where, "--clock-offset", 30, "--complete")
    assert data["ok"] and data["proved"] == 1, data
    assert answer(tmp_path, "verify", "--against", shown, *where, "--anew")["exit"] == 1


def test_questions_are_asked_until_everything_is_proved(
    device: tuple[Process, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from gateway.commission import verify as module

    process = device[0]
    force(process, "TCuscinettiRiduttore", 40.1)
    asked: list[str] = []

    def person(question: str) -> str:
        asked.append(question)
        if "another state" in question:
            force(process, "TCuscinettiRiduttore", 55.3)
            wait_until(lambda: process.order("values")["values"]["TCuscinettiRiduttore"] == pytest.approx(55.3))
            return ""
        return "40,1" if len(asked) == 1 else "55,3"

    monkeypatch.setattr(module, "_ask", person)
    data = answer(tmp_path, "verify", "--only", "TCuscinettiRiduttore", *links(device)["modbus"])
    assert data["ok"] and data["proved"] == 1 and len(asked) == 3, asked
    assert "40" not in asked[0]


# ---------------------------------------------------------------- soak and replay


def test_a_soak_counts_what_was_lost_and_keeps_a_recording(tmp_path: Path) -> None:
    with running() as process:
        force(process, "Coppia", 33.0)
        process.fault("exception", code=10, count=2)
        options = ("--seconds", 1.5, "--period", 0.1, "--record", tmp_path / "soak.csv")
        data = answer(tmp_path, "soak", *options, "--device", DECANTER, *at(process))
    assert data["exit"] == 1 and data["scans_with_bad"] >= 1 and data["bad_tags"]["Coppia"] >= 1
    kept = read_recording(tmp_path / "soak.csv")
    assert len(kept.times) == data["scans"]
    assert sorted({value for value in kept.columns["Coppia"] if value == value}) == [33.0]
    assert sum(value != value for value in kept.columns["Coppia"]) == data["bad_tags"]["Coppia"]
    assert data["exchanges"]["refused"] >= 1


@pytest.mark.parametrize("link", ["canopen", "can"])
def test_a_device_that_speaks_by_itself_is_judged_by_the_age_of_what_it_said(
    device: tuple[Process, Path], tmp_path: Path, link: str
) -> None:
    started = ("--set", "configure=true") if link == "canopen" else ()
    data = answer(tmp_path, "soak", "--seconds", 1.0, "--period", 0.2, *started, *links(device)[link])
    assert "scans" in data, data
    assert data["scans"] >= 1, data
    assert data["age_ms"]["max"] >= data["age_ms"]["p50"] > 0
    assert data["recommended_period_s"] is None and "speaks by itself" in " ".join(data["notes"])


@pytest.mark.parametrize(("fault", "told"), [("silent", True), ("busy", False)])
def test_a_silent_device_has_its_cure_told_over_any_link(tmp_path: Path, fault: str, told: bool) -> None:
    file = tmp_path / "soft.toml"
    file.write_text(
        f'[device]\nname = "soft"\ndriver = "soft"\noutages = [[0.0, 1e9, "{fault}"]]\n'
        '[[tags]]\nname = "five"\naddress = "five"\n'
    )
    result = plc(tmp_path, "soak", "--seconds", 0.3, "--period", 0.1, "--device", file, "--json")
    data = json.loads(result.stdout.splitlines()[0])
    assert data["exit"] != 0 and data["scans_with_bad"] == data["scans"]
    assert ("does not help" in result.output) is told and (data["recommended_period_s"] is None) is told


@pytest.mark.parametrize(
    ("seconds", "factor", "period"),
    [([0.01] * 100, 1.0, 0.05), ([0.06] * 100, 1.0, 0.2), ([0.01] * 99 + [0.4], 1.0, 0.5), ([0.06] * 9, 3.0, 0.5),
     ([70.0], 1.0, 180.0)],
)  # fmt: skip
def test_the_recommended_period_leaves_room_and_holds_the_longest_scan(
    seconds: list[float], factor: float, period: float
) -> None:
    assert recommend_period(seconds, factor) == period


def plant(folder: Path) -> Path:
    (folder / "model.json").write_text(model_text(known_model()), encoding="utf-8")
    path = folder / "plant.toml"
    path.write_text(
        f'[device]\nfile = "{DECANTER}"\n[model]\npath = "model.json"\n[scan]\nperiod = 1.0\n'
        '[historian]\npath = "own.sqlite"\n[forecast]\nhorizons = [10]\nruns = 50\nperiod = 5\n'
        '[writeback]\nmode = "shadow"\n',
        encoding="utf-8",
    )
    return path


def test_a_recording_goes_through_the_whole_gateway_and_leaves_no_trace_of_its_own(tmp_path: Path) -> None:
    trace = restless_trace(60.0)
    write_trace(trace, tmp_path / "trace.csv")
    data = answer(tmp_path, "replay", tmp_path / "trace.csv", "--config", plant(tmp_path))
    assert data["ok"], data
    assert data["scans"] >= 59 and data["events"] > 20
    assert data["blocks"] == data["scans"] and data["blocks_valid"] > 0
    assert data["one_step"]["count"] > 0 and data["forecasts"][0]["count"] > 0
    assert sorted(found.name for found in tmp_path.iterdir()) == [
        "model.json", "plant.toml", "records.jsonl", "trace.csv"
    ]  # fmt: skip


def test_a_recording_may_have_cells_with_line_breaks_and_comments_between_its_rows(tmp_path: Path) -> None:
    path = tmp_path / "rec.csv"
    path.write_text('# by hand\ntime,Coppia,"Corrente\n# [A]"\n\n0,"1\n",true\n# pause\n1,,7.5\n', encoding="utf-8")
    kept = read_recording(path)
    assert list(kept.times) == [0.0, 1.0]
    assert list(kept.columns) == ["Coppia", "Corrente\n# [A]"]
    assert kept.columns["Coppia"][0] == 1.0 and math.isnan(kept.columns["Coppia"][1])
    assert list(kept.columns["Corrente\n# [A]"]) == [1.0, 7.5]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,Anderes\n0,1\n1,2\n", ("has no column of a tag",)),
        ("zeit,Coppia\n0,1\n", ("line 1", "'time'")),
        ("time,Coppia\n5,1\n4,2\n", ("line 3", "goes back")),
        ("time,Coppia\n5,x\n", ("line 2, 'Coppia'", "no number")),
        ("time,Coppia\n# spoken\n\n5,1,2\n", ("line 4", "3 cells for 2 columns")),
        ('time,Coppia\n5,1\n6,"2\n7,3\n', ("line 3", "is not CSV")),
        ('time,"Coppia\n\n# Nm"\n5,1\n4,2\n', ("line 5", "goes back")),
    ],
)
def test_a_recording_that_cannot_be_used_is_one_sentence(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    (tmp_path / "rec.csv").write_text(text, encoding="utf-8")
    result = plc(tmp_path, "replay", tmp_path / "rec.csv", "--config", plant(tmp_path))
    assert result.exit_code == 2 and all(word in result.stderr for word in words), result.stderr
