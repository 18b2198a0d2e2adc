"""The acceptance report: made of the commands' own records, nothing left out, and a changed byte shows."""

import json
import shutil
import time
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from random import Random
from typing import Any

import pytest
from click.testing import CliRunner, Result

from gateway.cli.main import main
from gateway.commission.acceptance.data import CHECKS, FAILED, INCOMPLETE, OPEN, PASSED, gather
from gateway.commission.acceptance.files import FILES, LIST, verify, write
from gateway.commission.session.records import CommandRecord, append, sha256_hex
from gateway.machine.writing.arming import arm_in_log, disarm_in_log, sign_arming
from gateway.machine.writing.witnessing import countersign
from gateway.store.audit import read
from gateway.store.witness import default_places

NEEDED = [check.command for check in CHECKS if check.required == "always"]
WRITING = [check.command for check in CHECKS if check.required == "writing"]


def record(command: str, code: int = 0, reason: str = "", **more: Any) -> CommandRecord:
    given: dict[str, Any] = {
        "time": 1_795_000_000.0,
        "seconds": 1.5,
        "command": command,
        "arguments": {"period": 1.0},
        "place": "modbus, host 10.0.0.7 port 502 unit 1",
        "code": code,
        "reason": reason,
        "result": {},
        "frames": {"sent": 3, "received": 3, "bytes": 99, "sha256": "ab" * 32, "pcap": None},
        "configuration": {},
        "versions": {"python": "3.11", "decanter-gateway": "0.1.0"},
        "who": "Ada",
        "machine": "laptop",
    }
    return CommandRecord(**{**given, **more})


def filled(folder: Path, *records: CommandRecord) -> Path:
    path = folder / "records.jsonl"
    for one in records:
        append(path, one)
    return path


def complete(folder: Path, *others: CommandRecord) -> Path:
    return filled(folder, *(record(name) for name in NEEDED), *others)


def data_of(records: Path, audit: Path | None = None, **keys: Any) -> dict[str, Any]:
    given = {"site": "plant", "by": "Ada", "now": time.time(), **keys}
    return gather(records, default_places(audit or records.with_name("audit.sqlite")), **given)


def test_all_that_is_required_and_passed_is_a_passed_site(tmp_path: Path) -> None:
    data = data_of(complete(tmp_path))
    assert (data["verdict"], data["open_points"]) == (PASSED, [])
    assert [check["command"] for check in data["checks"] if check["state"] == "passed"] == NEEDED
    assert len(data["records"]["rows"]) == len(NEEDED)
    assert all(row["frames"]["sha256"] == "ab" * 32 for row in data["records"]["rows"])


@pytest.mark.parametrize("left_out", NEEDED)
def test_a_required_check_that_was_not_done_leaves_the_site_not_complete(tmp_path: Path, left_out: str) -> None:
    data = data_of(filled(tmp_path, *(record(name) for name in NEEDED if name != left_out)))
    assert data["verdict"] == INCOMPLETE and data["open_points"][0].startswith(f"{left_out} was not done")


def test_the_newest_try_that_came_to_a_result_counts(tmp_path: Path) -> None:
    path = complete(tmp_path, record("soak", 1, "too slow"))
    assert data_of(path)["verdict"] == FAILED and "soak failed: too slow" in data_of(path)["open_points"]
    append(path, record("soak"))
    assert data_of(path)["verdict"] == PASSED
    for code in (2, 6, 130):
        append(path, record("soak", code, "not carried out"))
    data = data_of(path)
    assert data["verdict"] == PASSED
    assert next(check for check in data["checks"] if check["command"] == "soak")["tries"] == 3


def test_a_site_that_was_armed_needs_the_tests_of_writing_too(tmp_path: Path) -> None:
    path = complete(tmp_path, record("arm"))
    data = data_of(path)
    assert data["verdict"] == INCOMPLETE and len(data["open_points"]) == len(WRITING)
    for name in WRITING:
        append(path, record(name, result={"asked": True, "watchdog": True}))
    assert data_of(path)["verdict"] == PASSED


def test_what_a_passed_check_has_left_open_is_an_open_point(tmp_path: Path) -> None:
    path = complete(
        tmp_path,
        record("doctor", result={"steps": [{"step": "clock", "state": "warning", "sentence": "no time server"}]}),
        record("verify", result={"open_points": ["verify: TFango: a second value"], "clock_offset": 1.25}),
        record("loop alarms", result={"asked": False}),
        record("loop heartbeat", result={"watchdog": False}),
        record("test conformance", result={"rows": [{"step": "no permit", "skipped": "nobody there"}]}),
    )
    data = data_of(path, remarks=["earthing of the shield"])
    assert data["verdict"] == OPEN
    text = "\n".join(data["open_points"])
    for words in (
        "doctor: no time server",
        "verify: TFango: a second value",
        "nobody was asked",
        "the PLC's timer was left out",
        "conformance: 1 steps could not be put, the first: no permit",
        "earthing of the shield",
    ):
        assert words in text
    assert data["clock"] == {"machine": "no time server", "hmi_offset_s": 1.25}


def test_a_configuration_that_was_changed_since_is_an_open_point(tmp_path: Path) -> None:
    used = tmp_path / "plant.toml"
    used.write_text("a = 1\n")
    path = complete(tmp_path, record("check", configuration={str(used): sha256_hex(used.read_bytes())}))
    assert data_of(path)["verdict"] == PASSED
    used.write_text("a = 2\n")
    assert "was changed after it was last used" in data_of(path)["open_points"][0]
    used.unlink()
    assert "is no longer there" in data_of(path)["open_points"][0]


def test_records_that_were_changed_fail_the_site(tmp_path: Path) -> None:
    path = complete(tmp_path)
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0].replace('"seconds": 1.5', '"seconds": 1.6'), *lines[1:]]) + "\n")
    data = data_of(path)
    assert data["verdict"] == FAILED and "the records were changed" in data["open_points"][0]


def test_armings_names_and_an_arming_that_still_stands_are_in_it(tmp_path: Path) -> None:
    path, audit, now = complete(tmp_path), tmp_path / "audit.sqlite", time.time()
    arm_in_log(audit, sign_arming("Bea", "loop test", 5, now), now)
    data = data_of(path, audit)
    assert data["names"] == ["Ada", "Bea"] and data["open_points"][0].startswith("still armed: by Bea (loop test)")
    disarm_in_log(audit, "Bea", "done", time.time())
    data = data_of(path, audit)
    assert data["verdict"] == PASSED and data["audit"]["kinds"] == {"armed": 1, "confirmed": 1, "disarmed": 1}
    assert len(data["audit"]["head"]) == 64


@pytest.mark.parametrize("gone", [False, True])
def test_the_audit_logs_end_is_held_against_its_signed_heads(tmp_path: Path, gone: bool) -> None:
    path, audit, now = complete(tmp_path), tmp_path / "audit.sqlite", time.time()
    arm_in_log(audit, sign_arming("Bea", "loop test", 5, now), now)
    disarm_in_log(audit, "Bea", "done", time.time())
    countersign(default_places(audit), now)
    assert data_of(path, audit)["audit"]["end"] == "rows 1 to 3 are witnessed"
    for file in tmp_path.glob("audit.sqlite*"):
        file.unlink()
    if not gone:  # begun anew, and whole in itself
        disarm_in_log(audit, "Bea", "done", time.time())
    data = data_of(path, audit)
    assert data["verdict"] == FAILED and "row 3" in data["open_points"][0] and "was signed" in data["open_points"][0]


# ---------------------------------------------------------------- the files


class Words(HTMLParser):
    """All text of a page, and the tags that would load something."""

    def __init__(self) -> None:
        super().__init__()
        self.text: list[str] = []
        self.loads: list[str] = []

    def handle_data(self, data: str) -> None:
        self.text.append(data)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ("script", "img", "link", "iframe") or any(name in ("src", "href") for name, _ in attrs):
            self.loads.append(tag)


def made(folder: Path, *others: CommandRecord) -> tuple[Path, str]:
    records = complete(folder, *others)
    out = folder / "report"
    return out, write(out, data_of(records, site="Plant <b>&</b> è"), records.read_bytes())


@pytest.fixture(scope="module")
def ready(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A report and its seal, made once: whoever changes it takes a copy."""
    return made(tmp_path_factory.mktemp("ready"))


@pytest.fixture
def copied(ready: tuple[Path, str], tmp_path: Path) -> tuple[Path, str]:
    """A report of its own, with its seal."""
    out, seal = ready
    return Path(shutil.copytree(out, tmp_path / "report")), seal


def test_the_page_has_every_record_escapes_what_it_shows_and_loads_nothing(tmp_path: Path) -> None:
    rows = [{"tag": f"<script>alert({number})</script>", "ok": number % 2 == 0} for number in range(500)]
    out, _ = made(tmp_path, record("verify", 1, "<img src=x>", result={"rows": rows}))
    page = Words()
    page.feed((out / "report.html").read_text(encoding="utf-8"))
    text = " ".join(page.text)
    assert page.loads == [] and "<script>alert(7)</script>" in text and "Plant <b>&</b> è" in text
    assert text.count("ab" * 32) == len(NEEDED) + 1
    assert "The first 400 of 500 are shown" in text
    assert f"SHA-256 {sha256_hex((out / 'report.json').read_bytes())}" in text
    assert len(json.loads((out / "report.json").read_text())["records"]["rows"][-1]["result"]["rows"]) == 500


def test_the_paper_is_a_pdf_of_the_same_and_bears_the_datas_hash(tmp_path: Path) -> None:
    out, _ = made(tmp_path, record("verify", result={"rows": [{"name": "è Ω –", "value": 1.5}]}))
    content = (out / "report.pdf").read_bytes()
    assert content.startswith(b"%PDF-") and content.rstrip().endswith(b"%%EOF")
    assert content.count(b"/Type /Page\n") >= 2


@pytest.mark.parametrize("name", [*FILES, LIST])
def test_a_changed_byte_in_any_file_shows(copied: tuple[Path, str], name: str) -> None:
    out, seal = copied
    assert all(row.ok for row in verify(out, seal)[1])
    content, random = (out / name).read_bytes(), Random(name)
    places = range(len(content)) if name == LIST else random.sample(range(len(content)), 40)
    for place in places:
        changed = bytearray(content)
        changed[place] ^= 1 << random.randrange(8)
        (out / name).write_bytes(changed)
        try:
            rows = verify(out)[1]
        except (ValueError, OSError):
            continue
        assert not all(row.ok for row in rows), f"byte {place} of {name}"


CHANGES: dict[str, Callable[[bytes], bytes]] = {
    "one more byte": lambda content: content + b"\n",
    "one less": lambda content: content[:-1],
    "nothing left": lambda content: b"",
}


@pytest.mark.parametrize("name", [*FILES, LIST])
@pytest.mark.parametrize("change", CHANGES)
def test_added_and_missing_bytes_show_too(copied: tuple[Path, str], name: str, change: str) -> None:
    out, _ = copied
    (out / name).write_bytes(CHANGES[change]((out / name).read_bytes()))
    try:
        assert not all(row.ok for row in verify(out)[1])
    except ValueError as error:
        assert "changed" in str(error)


def test_a_missing_file_and_a_report_made_anew_show(tmp_path: Path) -> None:
    out, seal = made(tmp_path)
    (out / "report.pdf").unlink()
    assert {row.file: row.problem for row in verify(out)[1]}["report.pdf"] == "is missing"
    data = data_of(tmp_path / "records.jsonl", site="another")
    write(out, data, (tmp_path / "records.jsonl").read_bytes())
    assert all(row.ok for row in verify(out)[1])
    assert "another one than was signed" in verify(out, seal)[1][-1].problem


# ---------------------------------------------------------------- the command


def decanter(folder: Path, *words: str) -> Result:
    environment = {"DECANTER_RECORDS": str(folder / "records.jsonl"), "DECANTER_BY": "Ada"}
    return CliRunner().invoke(main, ["plc", *words], env=environment)


def test_the_command_makes_it_seals_it_in_the_audit_log_and_verifies_it(tmp_path: Path) -> None:
    complete(tmp_path)
    now = time.time()
    arm_in_log(tmp_path / "audit.sqlite", sign_arming("Ada", "x", 5, now), now)
    disarm_in_log(tmp_path / "audit.sqlite", "Ada", "x", time.time())
    out = str(tmp_path / "sat")
    done = decanter(tmp_path, "report", "--out", out, "--site", "plant", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    assert told["verdict"] == PASSED
    (sealed,) = read(tmp_path / "audit.sqlite", ["acceptance report"])
    assert sealed.entry.detail["seal"] == told["seal"]
    assert decanter(tmp_path, "report", "--verify", "--out", out, "--seal", told["seal"]).exit_code == 0
    page = tmp_path / "sat" / "report.html"
    page.write_bytes(page.read_bytes().replace(b"passed", b"Passed", 1))
    failed = decanter(tmp_path, "report", "--verify", "--out", out)
    assert failed.exit_code == 1 and "report.html: was changed" in failed.stderr


def test_the_command_says_in_a_sentence_what_it_lacks(tmp_path: Path) -> None:
    assert decanter(tmp_path, "report").exit_code == 2
    nothing = decanter(tmp_path, "report", "--verify", "--out", str(tmp_path / "none"))
    assert nothing.exit_code == 2 and "Traceback" not in nothing.output
    complete(tmp_path, record("verify", 1, "TFango differs"))
    failed = decanter(tmp_path, "report", "--out", str(tmp_path / "sat"))
    assert failed.exit_code == 1 and "TFango differs" in failed.stderr
