"""`trace ingest`: every kind by its own reader, a sentence for what is refused, and what a kill leaves."""

import fcntl
import json
import os
import shutil
import signal
import sqlite3
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from errno import EACCES, EINVAL
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from drivers.tag import Tag
from gateway.lab.ingestion import archive as archive_module
from gateway.lab.ingestion import ingest as ingest_module
from gateway.lab.ingestion.archive import MANIFEST, open_archive
from gateway.lab.ingestion.ingest import FolderWatch, ingest_units
from gateway.lab.ingestion.recognising import PLACES, list_units
from gateway.lab.json_rows import append_row, read_rows
from sim.lab.recordings import write_trace
from sim.plc.record import PlcRecorder
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
    with open_archive(archive):
        refused(decanter(*call, archive), 2, "another process is ingesting into this archive")
    (archive / MANIFEST).write_text('{"name": "x"}\n', encoding="utf-8")
    refused(decanter(*call, archive), 2, "manifest.jsonl:1: kind: is missing")
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
    with open_archive(archive) as opened:
        list(ingest_units(list_units(folder, archive), opened, {}, move=True, clock=lambda: 0.0))


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
        return len(watch.due(list_units(tmp_path, tmp_path / "archive"), now))

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


def trace_file(path: Path, seconds: float = 600.0) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_trace(measured(seconds), path)
    return path


def with_column(path: Path, source: Path, name: str, cell: str, mark: str = ",") -> Path:
    """A trace with one more column, which the map does not read."""
    lines = [line for line in source.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = [f"{line},{name if number == 0 else cell}".replace(",", mark) for number, line in enumerate(lines)]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("move", [(), ("--move",)])
def test_a_file_that_another_process_has_open_for_writing_is_left_until_it_is_closed(
    tmp_path: Path, move: tuple[str, ...]
) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    file = trace_file(folder / "log.csv")
    with file.open("a", encoding="utf-8") as logger:
        said = reasons(folder, archive, *move)
        assert said == {"log.csv": f"{file}: is open for writing by another process; close it first"}
        assert set(tree(archive)) == {".lock"}
        logger.write("# the end\n")
    assert take(folder, archive, *move)["counts"]["taken"] == 1
    assert (archive / "traces/log.csv").read_text(encoding="utf-8").endswith("# the end\n")
    assert file.exists() == (not move)


def test_a_file_that_is_opened_for_writing_after_it_was_copied_is_not_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    file = trace_file(folder / "log.csv")
    with ExitStack() as writers:

        def opened(path: Path, row: Any) -> None:
            append_row(path, row)
            writers.enter_context(file.open("a", encoding="utf-8"))

        monkeypatch.setattr(archive_module, "append_row", opened)
        assert "is open for writing" in reasons(folder, archive, "--move")["log.csv"]
    assert file.exists()
    assert take(folder, archive, "--move")["counts"]["there already"] == 1 and not file.exists()


def test_where_the_system_gives_no_lease_files_are_taken_as_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, archive, real = tmp_path / "usb", tmp_path / "archive", fcntl.fcntl
    file = trace_file(folder / "log.csv")

    def without_leases(handle: int, command: int, argument: int = 0) -> int:
        if command == fcntl.F_SETLEASE:
            raise OSError(EINVAL, "Invalid argument")
        return int(real(handle, command, argument))

    monkeypatch.setattr(fcntl, "fcntl", without_leases)
    with file.open("a", encoding="utf-8"):
        assert take(folder, archive, "--move")["counts"]["taken"] == 1
    assert not file.exists()


def test_what_cannot_be_removed_is_taken_and_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    trace_file(folder / "a.csv")
    trace_file(folder / "b.csv", 700.0)

    real = Path.unlink

    def forbidden(path: Path, missing_ok: bool = False) -> None:
        if folder in path.parents:
            raise PermissionError(EACCES, "Permission denied", str(path))
        real(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", forbidden)
    told = decanter("trace", "ingest", folder, "--into", archive, "--map", "decanter", "--move")
    assert told.exit_code == 1 and "2 taken, 0 completed, 0 there already, 0 refused" in told.stdout
    assert told.stderr == (
        f"2 of them could not be removed from {folder} (permission denied); remove them as a user who may write there\n"
    )
    data = take(folder, archive, "--move")
    assert (data["counts"]["there already"], data["unremoved"]) == (2, 2)


def test_a_place_that_something_else_has_refuses_that_file_alone(tmp_path: Path) -> None:
    first, second, archive = tmp_path / "first", tmp_path / "second", tmp_path / "archive"
    trace_file(first / "a.csv")
    trace_file(first / "b.csv/inner.csv", 610.0)
    take(first, archive)
    trace_file(second / "a.csv/below.csv", 700.0)
    trace_file(second / "b.csv", 710.0)
    trace_file(second / "A.csv", 720.0)
    trace_file(second / "CON.csv", 730.0)
    trace_file(second / "z.csv", 740.0)
    data = take(second, archive)
    said = {Path(each["source"]).name: each["why"] for each in data["files"] if each["why"]}
    assert "archive/traces/a.csv is a file, where this one needs a folder" in said["below.csv"]
    assert "archive/traces/b.csv is a folder, where this one needs a file" in said["b.csv"]
    assert "traces/a.csv in" in said["A.csv"] and "has this name but for capitals" in said["A.csv"]
    assert "'CON.csv' is the name of a device on Windows; rename it" in said["CON.csv"]
    assert data["counts"]["taken"] == 1 and data["counts"]["refused"] == 4


def test_a_trace_with_another_column_is_no_double_of_one_that_the_map_reads_alike(tmp_path: Path) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    plain = trace_file(folder / "plain.csv")
    with_column(folder / "remarked.csv", plain, "remark", "by hand")
    with_column(folder / "turned.csv", plain, "flow", "1.5")
    assert take(folder, archive)["counts"]["taken"] == 3
    second = tmp_path / "second"
    second.mkdir()
    with_column(second / "a.csv", plain, "flow", "1.50", ";")
    with_column(second / "b.csv", plain, "remark", "by hand", ";")
    with_column(second / "c.csv", plain, "flow", "1.6")
    data = take(second, archive)
    said = {Path(each["source"]).name: each["why"] for each in data["files"]}
    assert "has readings that are, in another form, in" in said["a.csv"] and "traces/turned.csv (from" in said["a.csv"]
    assert "traces/remarked.csv (from" in said["b.csv"] and said["c.csv"] == ""
    # Before anything is written, the file that came first stands for what would be in the archive.
    dry = take(second, tmp_path / "new", "--dry-run")
    assert dry["counts"]["taken"] == 3


def test_a_long_trace_with_other_rows_is_no_double_of_one_that_the_map_reads_alike(tmp_path: Path) -> None:
    folder = tmp_path / "usb"
    folder.mkdir()
    rows = [f"{time},{name},{80 + time}" for time in range(20) for name in ("COOLANT_TEMP", "ENGINE_RPM", "FUEL")]
    for name, text in (
        ("a.csv", "\n".join(rows)),
        ("b.csv", "\n".join(rows).replace(",", ";")),
        ("c.csv", "\n".join(rows).replace("FUEL,80", "FUEL,79")),
    ):
        mark = ";" if ";" in text else ","
        (folder / name).write_text(f"time_s{mark}signal{mark}value\n{text}\n", encoding="utf-8")
    data = take(folder, tmp_path / "archive", "--map", "can_obd2")
    assert [each["verdict"] for each in data["files"]] == ["taken", "refused", "taken"]
    assert "in another form, in" in data["files"][1]["why"]


def test_names_that_are_no_utf8_are_refused_and_nothing_of_them_is_copied(tmp_path: Path) -> None:
    archive, strange = tmp_path / "archive", os.fsdecode(b"usb\xe9")
    trace_file(tmp_path / "usb" / os.fsdecode(b"t\xe9.csv"))
    (said,) = reasons(tmp_path / "usb", archive).values()
    assert said.endswith("t\\udce9.csv': is no UTF-8; rename what in it shows as \\udc..")
    assert set(tree(archive)) == {".lock"}
    trace_file(tmp_path / strange / "t.csv")
    refused(decanter("trace", "ingest", tmp_path / strange, "--into", tmp_path / "other"), 2, "is no UTF-8")
    assert not (tmp_path / "other").exists()


def test_links_to_folders_are_told_and_links_in_a_circle_are_a_sentence(tmp_path: Path) -> None:
    folder, loop = tmp_path / "usb", tmp_path / "loop"
    trace_file(tmp_path / "elsewhere/t.csv")
    folder.mkdir()
    (folder / "linked").symlink_to(tmp_path / "elsewhere")
    loop.symlink_to(loop)
    said = reasons(folder, tmp_path / "archive")
    assert said == {"linked": f"{folder / 'linked'}: is a link to a folder; ingest that folder itself"}
    refused(decanter("trace", "ingest", folder, "--into", loop), 2, "is a link that leads back to itself")


def test_a_log_that_is_half_unreadable_says_so(tmp_path: Path) -> None:
    (tmp_path / "usb").mkdir()
    first, second = CANDUMP.splitlines()
    (tmp_path / "usb/trip.log").write_text(f"{first}\nrubbish\n{second}\nrubbish\n", encoding="utf-8")
    told = decanter("trace", "ingest", tmp_path / "usb", "--into", tmp_path / "archive")
    assert "can_logs/trip.log; 2 of 4 lines are read, see `decanter trace can`" in told.stdout


def test_what_is_wrong_with_a_trace_is_said_by_the_map_that_it_was_written_for(tmp_path: Path) -> None:
    folder = tmp_path / "usb"
    text = trace_file(folder / "header.csv").read_text(encoding="utf-8")
    (folder / "header.csv").write_text(text[: text.index("\n", text.index("time,")) + 1], encoding="utf-8")
    (folder / "binary.csv").write_bytes(bytes(range(256)) * 8)
    found = decanter("trace", "ingest", folder, "--into", tmp_path / "archive", "--json").stdout
    said = {Path(each["source"]).name: each["why"] for each in only_object(found)["files"]}
    assert said["header.csv"].endswith("none of its 0 rows can be used; there is only a header")
    assert said["binary.csv"].endswith("this is not a text file; give the CSV, unpacked")


EDITED: tuple[tuple[dict[str, Any], str], ...] = (
    ({"source": None}, "source: must be text, got None"),
    ({"files": ["x"]}, "files: must be a table"),
    ({"missing": 5}, "missing: must be a list, got 5"),
    ({"readings": ["a"]}, "readings: must be text"),
    ({"rows": "x"}, "rows: must be a whole number"),
)


@pytest.mark.parametrize(("change", "sentence"), EDITED)
def test_a_row_of_the_manifest_that_was_edited_has_one_sentence(
    tmp_path: Path, change: dict[str, Any], sentence: str
) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    trace_file(folder / "t.csv")
    take(folder, archive)
    (row,) = read_rows(archive / MANIFEST)
    call = ("trace", "ingest", folder, "--into", archive, "--map", "decanter")
    (archive / MANIFEST).write_text(json.dumps(row | change) + "\n", encoding="utf-8")
    refused(decanter(*call), 2, f"manifest.jsonl:1: {sentence}", "or take that line out")
    del row[next(iter(change))]
    (archive / MANIFEST).write_text(json.dumps(row) + "\n", encoding="utf-8")
    if "readings" in change or "rows" in change:
        assert decanter(*call).exit_code == 0  # only traces have them
    else:
        refused(decanter(*call), 2, f"manifest.jsonl:1: {next(iter(change))}: is missing; add it")


def test_a_last_row_without_a_line_break_is_a_row_and_stays(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_text('{"a": 1}\n{"a": 2}', encoding="utf-8")
    assert read_rows(path) == [{"a": 1}, {"a": 2}]
    append_row(path, {"a": 3})
    assert read_rows(path) == [{"a": 1}, {"a": 2}, {"a": 3}]


def test_half_a_character_at_the_end_is_no_row(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    path.write_bytes('{"a": 1}\n{"a": "é'.encode()[:-1])
    assert read_rows(path) == [{"a": 1}]
    append_row(path, {"a": 2})
    assert read_rows(path) == [{"a": 1}, {"a": 2}]


@pytest.mark.parametrize("mark", ["\u2028", "\u2029", "\x85", "\x0b", "\x1c"])
def test_only_a_line_feed_ends_a_row(tmp_path: Path, mark: str) -> None:
    folder, archive = tmp_path / f"press{mark}1", tmp_path / "archive"
    trace_file(folder / "t.csv")
    assert take(folder, archive)["counts"]["taken"] == 1
    assert read_rows(archive / MANIFEST)[0]["source"] == str(folder / "t.csv")
    assert take(folder, archive)["counts"]["there already"] == 1


def watch_with(
    monkeypatch: pytest.MonkeyPatch, folder: Path, archive: Path, steps: Sequence[Callable[[], object]]
) -> Result:
    """A watch in which a step is done between two looks, and Ctrl-C pressed after the last."""
    left = iter(steps)

    def slept(seconds: float) -> None:
        step = next(left, None)
        if step is None:
            signal.raise_signal(signal.SIGINT)
        else:
            step()

    monkeypatch.setattr(ingest_module.time, "sleep", slept)
    options = ("--map", "decanter", "--watch", "--rest", 0, "--every", 5)
    return decanter("trace", "ingest", folder, "--into", archive, *options)


def test_a_watch_waits_for_another_ingestion_and_says_so_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    trace_file(folder / "a.csv")
    with ExitStack() as other:
        other.enter_context(open_archive(archive))
        steps = [lambda: None, lambda: trace_file(folder / "b.csv", 700.0), lambda: None, other.close, lambda: None]
        told = watch_with(monkeypatch, folder, archive, steps)
    assert (told.exit_code, told.stderr.count("another process is ingesting into this archive")) == (0, 1)
    assert told.stdout.splitlines()[-1] == f"{archive}: 2 taken, 0 completed, 0 there already, 0 refused"


def test_a_watch_goes_on_when_its_folder_vanishes_and_comes_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    folder.mkdir()
    steps = [folder.rmdir, lambda: None, lambda: trace_file(folder / "a.csv"), lambda: None]
    told = watch_with(monkeypatch, folder, archive, steps)
    assert (told.exit_code, told.stderr.count("is not there any more")) == (0, 1)
    assert told.stdout.splitlines()[-1].startswith(f"{archive}: 1 taken")
    gone = watch_with(monkeypatch, folder, archive, [lambda: shutil.rmtree(folder), lambda: None])
    assert gone.exit_code == 1 and gone.stdout.splitlines()[-1].endswith("1 refused")


def test_a_watch_goes_on_when_a_file_vanishes_while_it_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, archive, real = tmp_path / "usb", tmp_path / "archive", ingest_module.recognise
    trace_file(folder / "a.csv")
    trace_file(folder / "b.csv", 700.0)

    def late(unit: Any, maps: Any) -> Any:
        if unit.source.name == "a.csv":
            unit.source.unlink()
        return real(unit, maps)

    monkeypatch.setattr(ingest_module, "recognise", late)
    told = watch_with(monkeypatch, folder, archive, [lambda: None, lambda: None])
    assert (
        told.exit_code == 0 and told.stderr == f"refused: {folder}/a.csv: has gone meanwhile; nothing is to be done\n"
    )
    assert told.stdout.splitlines()[-1] == f"{archive}: 1 taken, 0 completed, 0 there already, 0 refused"


def test_a_watch_takes_an_open_file_when_it_is_closed_and_counts_one_that_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, archive = tmp_path / "usb", tmp_path / "archive"
    closed, open_still = trace_file(folder / "a.csv"), trace_file(folder / "b.csv", 700.0)
    with closed.open("a", encoding="utf-8") as first, open_still.open("a", encoding="utf-8"):
        told = watch_with(monkeypatch, folder, archive, [lambda: None, lambda: None, first.close, lambda: None])
    assert told.exit_code == 1 and told.stderr.count("is open for writing") == 2
    assert told.stdout.splitlines()[-1] == f"{archive}: 1 taken, 0 completed, 0 there already, 1 refused"


def test_the_names_that_somebody_tries_first_say_where_the_commands_are() -> None:
    refused(decanter("ingest", "usb"), 2, "`decanter trace ingest`")
    refused(decanter("regress", "models"), 2, "`decanter model judge regression`")
