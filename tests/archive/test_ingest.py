"""`trace ingest`: every kind by its own reader, a sentence for what is refused, and what a kill leaves."""

import json
import os
import shutil
import signal
import sqlite3
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from drivers.tag import Tag
from gateway.lab.ingestion import archive as archive_module
from gateway.lab.ingestion import ingest as ingest_module
from gateway.lab.ingestion.archive import MANIFEST, opened_archive
from gateway.lab.ingestion.ingest import FolderWatch, ingested
from gateway.lab.ingestion.recognising import PLACES, units_in
from gateway.lab.json_rows import append_row, read_rows
from sim.plc.record import PlcRecorder
from sim.traces import write_trace
from tests.cli.artefact_set import FLOWS, files, written
from tests.cli.support import DATA, decanter, misused, only_object, refused
from tests.gateway.support import ROOT, one_machine
from tests.skill.test_forecasts_along import measured

CANDUMP = "(1627274455.023950) can0 7E8#03412F8C00000000\n(1627274455.044400) can0 7E8#0341054000000000\n"


def outside(folder: Path) -> Path:
    """A folder with a file of each kind, as each kind's own writer makes it where there is one."""
    (folder / "press1").mkdir(parents=True)
    write_trace(measured(600.0), folder / "press1/run.csv")
    written(folder / "learned", files())
    (folder / "alone").mkdir()
    (folder / "alone/flow_conditions.txt").write_text(FLOWS.replace("15", "16"), encoding="utf-8")
    recorder = PlcRecorder(folder / "plc.jsonl", pytest.fail)
    recorder("run", 1.0, {"device": "d", "seed": 0, "tags": ["T" * 100] * 100})
    recorder.close()
    one_machine(folder / "historian.sqlite", [Tag("T", "holding:0")])[0].close()
    (folder / "trip.log").write_text(CANDUMP, encoding="utf-8")
    (folder / "frames.csv").write_text(
        "timestamp,arbitration_id,extended,remote,error,dlc,data\n1.5,0x7e8,0,0,0,2,QQU=\n", encoding="utf-8"
    )
    shutil.copy(ROOT / "docs/demo.png", folder / "demo.png")
    shutil.copy(ROOT / "docs/alarm_states.svg", folder / "states.svg")
    return folder


def take(folder: Path, archive: Path, *options: object) -> dict[str, Any]:
    """What `trace ingest --json` answers."""
    maps = () if "--map" in options else ("--map", "decanter")
    return only_object(decanter("trace", "ingest", folder, "--into", archive, *maps, *options, "--json").stdout)


def reasons(folder: Path, archive: Path, *options: object) -> dict[str, str]:
    """The sentences of what was refused by the file's name."""
    found = take(folder, archive, *options)["files"]
    return {Path(each["source"]).name: each["why"] for each in found if each["verdict"] == "refused"}


def tree(archive: Path) -> dict[str, bytes]:
    return {path.relative_to(archive).as_posix(): path.read_bytes() for path in archive.rglob("*") if path.is_file()}


def test_each_kind_is_recognised_copied_and_listed_and_again_there_already(tmp_path: Path) -> None:
    folder, archive = outside(tmp_path / "usb"), tmp_path / "archive"
    dry = take(folder, archive, "--dry-run")
    assert not archive.exists() and dry["counts"]["taken"] == 9
    before = tree(folder)
    data = take(folder, archive)
    assert tree(folder).keys() == before.keys()
    assert tree(folder) == before and data["counts"] == {"taken": 9, "completed": 0, "there already": 0, "refused": 0}
    rows = {row["name"]: row for row in read_rows(archive / MANIFEST)}
    assert Counter(row["kind"] for row in rows.values()) == Counter(
        dict.fromkeys(PLACES, 1) | {"CAN log": 2, "plot": 2}
    )
    assert set(rows) == {row["name"] for row in dry["files"]}
    trace = rows["traces/press1/run.csv"]
    assert (trace["map"], trace["rows"], trace["used"]) == ("decanter", 60, 60)
    assert rows["artefacts/learned/SMALL"]["missing"] == [] and rows["can_logs/trip.log"]["frames"] == 2
    for name, row in rows.items():
        held = {f"{name}/{file}": content for file, content in row["files"].items()} or {name: row["sha256"]}
        assert all(archive_module.file_hash(archive / file) == content for file, content in held.items())
    assert take(folder, archive)["counts"]["there already"] == 9
    assert len(read_rows(archive / MANIFEST)) == 9
    told = decanter("trace", "ingest", folder, "--into", archive, "--map", "decanter")
    assert (told.exit_code, told.stdout) == (0, f"{archive}: 0 taken, 0 completed, 9 there already, 0 refused\n")


def test_what_is_refused_has_one_sentence_and_exit_code_1(tmp_path: Path) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    trace = outside(folder) / "press1/run.csv"
    take(folder, archive)
    second = tmp_path / "second"
    (second / "press1").mkdir(parents=True)
    shutil.copy(folder / "demo.png", second / "picture.png")
    # The same readings, saved by another program: other line ends, no comments.
    lines = [line for line in trace.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    (second / "saved.csv").write_bytes(("\r\n".join(lines) + "\r\n").encode())
    (second / "press1/run.csv").write_text("\n".join(lines[:30]) + "\n", encoding="utf-8")
    (second / "list.csv").write_text("tag;address\nT;40001\n", encoding="utf-8")
    (second / "book.xlsx").write_bytes(b"PK\x03\x04rest")
    (second / "empty.log").touch()
    (second / "text.log").write_text("started\n", encoding="utf-8")
    (second / "no.png").write_text("text", encoding="utf-8")
    (second / "cut.png").write_bytes((folder / "demo.png").read_bytes()[:-40])
    (second / "cut.svg").write_text("<svg><g>", encoding="utf-8")
    (second / "notes.txt").write_text("by hand\n", encoding="utf-8")
    (second / "a,b.csv").write_text("x\n", encoding="utf-8")
    (second / "link.csv").symlink_to(trace)
    os.mkfifo(second / "pipe.csv")
    (second / "live.sqlite").write_bytes((folder / "historian.sqlite").read_bytes())
    (second / "live.sqlite-wal").write_bytes(b"rows")
    other = sqlite3.connect(second / "other.sqlite")
    other.execute("CREATE TABLE t (a)")
    other.close()
    (second / "model").mkdir()
    (second / "model/model.json").write_text("{}", encoding="utf-8")
    part = {name: text for name, text in files("HALF").items() if name != "HALF_source.txt"}
    written(second / "half", part)
    written(second / "lone", {"HALF.txt": part["HALF.txt"]})
    said = reasons(second, archive)
    wanted = {
        "picture.png": "is in {archive} already as plots/demo.png (from {folder}/demo.png); nothing was taken",
        "saved.csv": "has readings that are, in another form, in {archive} already as traces/press1/run.csv",
        "run.csv": "has this name and another content; rename this one",
        "list.csv": "its columns are tag, address; give the file for which the column map was written",
        "book.xlsx": "is a workbook, and traces are read as CSV; save its sheet as .csv",
        "empty.log": "is empty; there is nothing to keep",
        "text.log": "there is no data frame in this candump log",
        "no.png": "is called .png, but its content is no such picture",
        "cut.png": "is a picture without its end; copy it again",
        "cut.svg": "is a picture without its end; copy it again",
        "notes.txt": "is none of trace, artefact set, flow file, PLC recording, historian, CAN log, plot",
        "a,b.csv": "'a,b.csv' is no name for an archive",
        "link.csv": "is a link; ingest the folder with the file itself",
        "pipe.csv": "it is a named pipe, not a file",
        "live.sqlite": "a gateway may be writing it",
        "other.sqlite": "is no historian",
        "model": "is a model of this program",
        "HALF": "HALF_source.txt is missing",
        "HALF.txt": "HALF_source.txt is missing",
    }
    for name, sentence in wanted.items():
        assert sentence.format(archive=archive, folder=folder) in said[name], said[name]
        assert "\n" not in said[name] and "Errno" not in said[name]
    assert len(said) == len(wanted)
    assert decanter("trace", "ingest", second, "--into", archive, "--map", "decanter").exit_code == 1
    every = reasons(second, tmp_path / "new", "--map", "skab", "--map", "carobd")
    assert "no column map reads it (tried skab, carobd); draft one with `decanter trace map`" in every["list.csv"]


def test_a_set_that_lacks_files_says_which_and_is_completed_when_they_come(tmp_path: Path) -> None:
    folder, archive, parts = tmp_path / "usb", tmp_path / "archive", files()
    late = "SMALL_histogram_values.txt"
    written(folder, {name: text for name, text in parts.items() if name != late})
    told = decanter("trace", "ingest", folder, "--into", archive)
    assert f"as artefact set artefacts/SMALL; missing of the set: {late}" in told.stdout
    written(folder, parts)
    assert take(folder, archive)["counts"]["completed"] == 1
    assert read_rows(archive / MANIFEST)[-1]["missing"] == []
    # A part of what is there whole is nothing new; another content under its name is.
    (folder / late).unlink()
    assert take(folder, archive)["counts"]["there already"] == 1
    (folder / late).write_text("D_0:\n0.5\nD_1:\n0.6\n", encoding="utf-8")
    assert "another content" in reasons(folder, archive)["SMALL"]


def test_moved_files_go_and_a_flow_file_of_two_sets_with_the_last(tmp_path: Path) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    written(folder, files("A") | files("B"))
    (folder / "B.txt").write_text(files()["SMALL.txt"] + "\n", encoding="utf-8")  # else B is A by another name
    (folder / "notes.txt").write_text("by hand\n", encoding="utf-8")
    data = take(folder, archive, "--move")
    assert data["counts"]["taken"] == 2 and [path.name for path in folder.iterdir()] == ["notes.txt"]
    assert len(list((archive / "artefacts").rglob("*.txt"))) == 8


def test_archives_are_guarded(tmp_path: Path) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    folder.mkdir()
    call = ("trace", "ingest", folder, "--into")
    refused(decanter(*call, folder), 2, "lies in the archive")
    refused(decanter("trace", "ingest", tmp_path / "none"), 2, "is no folder")
    (tmp_path / "full").mkdir()
    (tmp_path / "full/thesis.doc").touch()
    refused(decanter(*call, tmp_path / "full"), 2, "holds other things and is no archive")
    with opened_archive(archive):
        refused(decanter(*call, archive), 2, "another process is ingesting into this archive")
    (archive / MANIFEST).write_text('{"name": "x"}\n', encoding="utf-8")
    refused(decanter(*call, archive), 2, "manifest.jsonl:1: has no name and sha256")
    misused(decanter(*call, archive, "--watch", "--dry-run"), "--dry-run takes none")
    misused(decanter(*call, archive, "--for", "1"), "--for ends a watch")


def test_a_kill_at_any_moment_loses_nothing_and_leaves_no_half_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The process is ended, as SIGKILL ends it, before each call that changes the disk in turn, then called again."""
    parts = {name: text for name, text in files("A").items() if name != "flow_conditions.txt"}
    expected = {f"artefacts/A/{name}": text.encode() for name, text in parts.items()}
    ended = 0
    for moment in range(1, 200):
        folder, archive = tmp_path / f"{moment}/usb", tmp_path / f"{moment}/archive"
        written(folder, parts)
        child = os.fork()
        if child == 0:
            left = moment

            def dying(real: Any) -> Any:
                def call(*arguments: Any, **options: Any) -> Any:
                    nonlocal left
                    left -= 1
                    if not left:
                        os._exit(9)
                    return real(*arguments, **options)

                return call

            for owner, name in ((os, "fsync"), (Path, "replace"), (Path, "unlink"), (Path, "mkdir")):
                monkeypatch.setattr(owner, name, dying(getattr(owner, name)))
            one_pass(folder, archive)
            os._exit(0)
        code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        # Whatever the moment: each content is whole in the folder or in the archive, under its own name.
        for name, text in parts.items():
            here = [
                path.read_text(encoding="utf-8")
                for path in (folder / name, archive / "artefacts/A" / name)
                if path.exists()
            ]
            assert here and set(here) == {text}
        one_pass(folder, archive)
        left_over = {name: content for name, content in tree(archive).items() if name not in (MANIFEST, ".lock")}
        assert left_over == expected and len(read_rows(archive / MANIFEST)) == 1
        assert list(folder.iterdir()) == []
        if code == 0:
            break
        assert code == 9
        ended += 1
    assert ended > 20


def one_pass(folder: Path, archive: Path) -> None:
    with opened_archive(archive) as opened:
        list(ingested(units_in(folder, archive), opened, {}, move=True, clock=lambda: 0.0))


def test_a_file_that_changes_while_it_is_copied_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    folder.mkdir()
    (folder / "flow_conditions.txt").write_text(FLOWS, encoding="utf-8")
    monkeypatch.setattr(archive_module, "file_hash", lambda path: "0" * 64)
    assert "changed while it was copied" in reasons(folder, archive)["flow_conditions.txt"]
    assert set(tree(archive)) == {".lock"}


def test_a_source_that_is_written_after_it_was_copied_is_not_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    folder.mkdir()
    file = folder / "flow_conditions.txt"
    file.write_text(FLOWS, encoding="utf-8")

    def late(path: Path, row: Any) -> None:
        append_row(path, row)
        file.write_text(FLOWS + "# more\n", encoding="utf-8")

    monkeypatch.setattr(archive_module, "append_row", late)
    assert "so it stays" in reasons(folder, archive, "--move")["flow_conditions.txt"]
    assert file.exists() and (archive / "flows/flow_conditions.txt").read_text(encoding="utf-8") == FLOWS


def test_half_a_last_line_of_a_manifest_is_no_row_and_does_not_spoil_the_next(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    append_row(path, {"a": 1})
    with path.open("ab") as stream:
        stream.write(b'{"a": 2')
    assert read_rows(path) == [{"a": 1}]
    append_row(path, {"a": 3})
    assert [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] == [{"a": 1}, {"a": 3}]


def test_a_watch_takes_what_is_at_rest_once_and_again_when_it_changed(tmp_path: Path) -> None:
    file = tmp_path / "flow_conditions.txt"
    file.write_text("0\n", encoding="utf-8")
    watch = FolderWatch(rest=60.0)

    def due(now: float) -> int:
        return len(watch.due(units_in(tmp_path, tmp_path / "archive"), now))

    assert [due(0.0), due(59.0)] == [0, 0]
    file.write_text(FLOWS, encoding="utf-8")
    assert [due(61.0), due(120.0), due(121.0), due(500.0)] == [0, 0, 1, 0]
    file.unlink()
    assert due(501.0) == 0 and not watch._since and not watch._done


def test_a_watch_ends_by_control_c_with_its_summary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, archive, looks = tmp_path / "usb", tmp_path / "archive", iter(range(3))
    folder.mkdir()

    def slept(seconds: float) -> None:
        assert seconds == 5.0
        match next(looks, None):
            case 0:
                (folder / "flow_conditions.txt").write_text(FLOWS, encoding="utf-8")
                (folder / "notes.txt").write_text("by hand", encoding="utf-8")
            case None:
                signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(ingest_module.time, "sleep", slept)
    told = decanter("trace", "ingest", folder, "--into", archive, "--watch", "--every", 5, "--rest", 0)
    assert told.exit_code == 1 and told.stderr.count("\n") == 1
    assert told.stdout.splitlines()[-1] == f"{archive}: 1 taken, 0 completed, 0 there already, 1 refused"
    assert (archive / "flows/flow_conditions.txt").read_text(encoding="utf-8") == FLOWS


@pytest.fixture
def real(tmp_path: Path) -> Iterator[Path]:
    if not DATA.is_dir():
        pytest.skip(f"no real data in {DATA}")
    folder = tmp_path / "usb"
    thermo = [f"lsha_upstream/artefacts/THERMO_UPPAAL_1{end}" for end in (".txt", "_source.txt")]
    shutil.copytree(DATA / "lsha_upstream/artefacts/made", folder / "lsha_upstream/artefacts/made")
    for name in (
        *thermo,
        "lsha_upstream/made_cnc/_03_mar_1.csv",
        "can_obd2/j1939_186s_allframes.candump.log",
        "carobd/idle1.csv",
        "carobd/SOURCE.txt",
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(DATA / name, folder / name)
    yield folder


def test_real_traces_logs_and_learned_sets_are_told_apart(real: Path, tmp_path: Path) -> None:
    data = take(real, tmp_path / "archive", "--map", "decanter", "--map", "carobd", "--map", "made_cnc")
    kinds = Counter((each.get("kind"), each.get("map")) for each in data["files"])
    assert kinds == {
        ("artefact set", None): 2,
        ("trace", "made_cnc"): 1,
        ("trace", "carobd"): 1,
        ("CAN log", None): 1,
        (None, None): 1,
    }
    missing = {Path(each["name"]).name: each["missing"] for each in data["files"] if each.get("kind") == "artefact set"}
    assert missing["ENERGY_MADE_1"] == []
    assert missing["THERMO_UPPAAL_1"] == ["THERMO_UPPAAL_1_histogram_values.txt", "flow_conditions.txt"]
