"""Model directories and the versioned store: whole or not there, whatever happens while they are written."""

import errno
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from sim import files
from sim.artefacts.model_directory import MANIFEST, MODEL_FILE
from sim.artefacts.store import (
    CURRENT_LINK,
    VERSIONS_FOLDER,
    Force,
    current,
    load,
    promote,
    read_model,
    version_directory,
    versions,
)
from sim.files import ArtefactError
from sim.lab.formats.foreign.bundle import read_artefacts
from sim.lab.formats.write_model import save, write_model_directory
from sim.sha.model import Model
from tests.artefacts.models import decanter_model

ROOT = Path(__file__).parents[2]


FORCE = Force("tests", "it has every flow kind, and some grow without bound", 0.0)


def numbered(number: int) -> Model:
    return replace(decanter_model(), sensor_sigma=0.1 + number)


def test_versions_are_numbered_and_the_promoted_one_is_current(tmp_path: Path) -> None:
    store = tmp_path / "store"
    first = save(store, numbered(1), created=1.0)
    second = save(store, numbered(2), {"off": [19.0, 21.0]}, created=2.0, parent=first)
    assert versions(store) == (first, second)
    with pytest.raises(ArtefactError, match=f"no version is promoted; promote one of: {first}, {second}"):
        load(store)
    promote(store, second, FORCE)
    assert current(store) == second
    assert load(store) == read_model(store) == numbered(2)
    assert load(store, first) == numbered(1)
    promote(store, first, FORCE)
    assert read_model(store) == numbered(1)
    manifest = (version_directory(store, second) / MANIFEST).read_text(encoding="utf-8")
    assert f'"parent": "{first}"' in manifest
    assert '"created": 2.0' in manifest
    assert f'"data_hash": "{"ab" * 32}"' in manifest


def test_a_version_holds_all_artefacts(tmp_path: Path) -> None:
    version = save(tmp_path, decanter_model(), {"off": [19.0, 21.0]}, created=1.0)
    artefacts = read_artefacts(version_directory(tmp_path, version), "cd")
    assert artefacts.histogram is not None
    assert artefacts.histogram.runs[0]["D_0"] == (19.0, 21.0)


def test_ten_thousand_versions_stay_in_order(tmp_path: Path) -> None:
    save(tmp_path, numbered(1), created=1.0)
    (tmp_path / VERSIONS_FOLDER / "9999-00000000").mkdir()
    assert save(tmp_path, numbered(2), created=2.0).startswith("10000-")
    assert [name[:5] for name in versions(tmp_path)] == ["0001-", "9999-", "10000"]


@pytest.mark.parametrize(
    "name", [MODEL_FILE, "cd.txt", "cd_source.txt", "cd_histogram_values.txt", "flow_conditions.txt"]
)
def test_a_changed_byte_is_told_by_its_file(tmp_path: Path, name: str) -> None:
    version = save(tmp_path, decanter_model(), created=1.0)
    file = version_directory(tmp_path, version) / name
    file.write_bytes(file.read_bytes().replace(b"m", b"n", 1) + b" ")
    with pytest.raises(ArtefactError, match=f"{name}: its content has changed since it was written"):
        promote(tmp_path, version)
    file.unlink()
    with pytest.raises(ArtefactError, match=f"{name}: the manifest lists this file, but it cannot be read"):
        load(tmp_path, version)


def test_a_version_without_manifest_is_not_trusted(tmp_path: Path) -> None:
    version = save(tmp_path, decanter_model(), created=1.0)
    (version_directory(tmp_path, version) / MANIFEST).unlink()
    with pytest.raises(ArtefactError, match=r"manifest\.json: there is no such file"):
        load(tmp_path, version)


def test_a_version_that_is_not_there_is_told_with_those_that_are(tmp_path: Path) -> None:
    version = save(tmp_path, decanter_model(), created=1.0)
    with pytest.raises(ArtefactError, match=f"there is no version 'x'; there are: {version}"):
        load(tmp_path, "x")
    (tmp_path / CURRENT_LINK).write_text("0009-deadbeef\n")
    with pytest.raises(ArtefactError, match=f"names the version '0009-deadbeef', which is not there; .*{version}"):
        load(tmp_path)


WRITER = """
import os, sys
from pathlib import Path
from sim.artefacts.store import promote
from sim.lab.formats.write_model import save
from tests.artefacts.test_store import FORCE, numbered
store = Path(sys.argv[1])
for line in sys.stdin:
    writer = os.fork()
    if writer:
        os.waitpid(writer, 0)
        print("gone", flush=True)
        continue
    number = 0
    while True:
        promote(store, save(store, numbered(number % 3), {"off": [20.0] * 2000}, created=float(number)), FORCE)
        if number == 0:
            print(os.getpid(), flush=True)
        number += 1
"""
"""For each line on its input, a process of its own that saves and promotes until it is killed."""


def test_a_kill_at_any_moment_leaves_the_store_readable_and_loses_no_version(tmp_path: Path) -> None:
    save(tmp_path, numbered(0), created=0.0)
    promote(tmp_path, versions(tmp_path)[0], FORCE)
    seen: set[str] = set()
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)], cwd=ROOT, stdin=pipe, stdout=pipe, text=True
    ) as nursery:
        assert nursery.stdin is not None and nursery.stdout is not None
        for round_ in range(8):
            nursery.stdin.write("another\n")
            nursery.stdin.flush()
            writer = int(nursery.stdout.readline())
            time.sleep(0.05 + 0.013 * round_)
            os.kill(writer, signal.SIGKILL)
            assert nursery.stdout.readline() == "gone\n"
            found = versions(tmp_path)
            assert seen <= set(found)
            assert all(load(tmp_path, version) in map(numbered, range(3)) for version in set(found) - seen)
            seen = set(found)
            assert read_model(tmp_path) in map(numbered, range(3))
        nursery.stdin.close()
    assert all(load(tmp_path, version) in map(numbered, range(3)) for version in seen)
    assert len(seen) > 8
    save(tmp_path, numbered(1), created=1.0)
    assert not [path for path in (tmp_path / VERSIONS_FOLDER).iterdir() if path.name.startswith(".")]


def test_writers_at_the_same_time_get_versions_of_their_own(tmp_path: Path) -> None:
    made: list[str] = []
    threads = [
        threading.Thread(target=lambda n=n: made.append(save(tmp_path / "s", numbered(n), created=0.0)))
        for n in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(made) == list(versions(tmp_path / "s"))
    assert len({name.partition("-")[0] for name in made}) == 4


def test_a_full_disk_is_one_sentence_and_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = save(tmp_path / "store", numbered(1), created=1.0)
    write_model_directory(tmp_path / "model", numbered(1))

    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(ArtefactError, match=r"cannot be written \(No space left on device\); make room there"):
        save(tmp_path / "store", numbered(2), created=2.0)
    with pytest.raises(ArtefactError, match="No space left on device"):
        promote(tmp_path / "store", first, FORCE)
    with pytest.raises(ArtefactError, match="No space left on device"):
        write_model_directory(tmp_path / "model", numbered(2))
    monkeypatch.undo()
    assert versions(tmp_path / "store") == (first,)
    assert load(tmp_path / "store", first) == numbered(1)
    assert read_model(tmp_path / "model") == numbered(1)
    hidden = [path.name for path in tmp_path.rglob(".*") if path.name != ".lock"]
    assert hidden == []


def test_a_directory_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for write in (
        lambda out: save(out, decanter_model(), created=0.0),
        lambda out: write_model_directory(out, numbered(1)),
    ):
        with pytest.raises(ArtefactError, match=r"cannot be written .*; make room there, or choose a directory"):
            write(tmp_path / "file" / "below")


def test_a_model_directory_is_read_as_it_was_written_and_can_be_replaced(tmp_path: Path) -> None:
    out = tmp_path / "deep" / "model"
    assert write_model_directory(out, decanter_model("first")) == out / MODEL_FILE
    (out / "notes.txt").write_text("mine")
    write_model_directory(out, decanter_model("second"), {"off": [1.0]})
    assert read_model(out) == read_model(out / MODEL_FILE) == decanter_model("second")
    assert sorted(path.name for path in out.iterdir()) == [
        "flow_conditions.txt",
        "manifest.json",
        "model.json",
        "notes.txt",
        "second.txt",
        "second_histogram_values.txt",
        "second_source.txt",
    ]


def test_a_directory_with_other_things_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    for write in (
        lambda: save(tmp_path, decanter_model(), created=0.0),
        lambda: write_model_directory(tmp_path, numbered(1)),
    ):
        with pytest.raises(ArtefactError, match=r"it has thesis\.txt"):
            write()
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_manifest_cannot_reach_outside_its_directory(tmp_path: Path) -> None:
    out = tmp_path / "model"
    write_model_directory(out, numbered(1))
    (tmp_path / "outside").write_text("mine")
    manifest = out / MANIFEST
    manifest.write_text(manifest.read_text().replace('"cd.txt"', '"../outside"'))
    for use in (lambda: read_model(out), lambda: write_model_directory(out, numbered(2))):
        with pytest.raises(ArtefactError, match=r"'\.\./outside' is no file of this directory"):
            use()
    assert (tmp_path / "outside").read_text() == "mine"


def test_what_is_no_model_is_told_with_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("")
    with pytest.raises(ArtefactError, match=r"has neither model\.json nor store\.json \(it has a\.csv\)"):
        read_model(tmp_path)
    with pytest.raises(ArtefactError, match="there is no such file"):
        read_model(tmp_path / "gone.json")
    with pytest.raises(ArtefactError, match=r"is no model store \(no store\.json in it\)"):
        versions(tmp_path)


def test_reading_a_model_loads_no_grammar_and_no_learner() -> None:
    """The running gateway reads models; the public formats and the learner's tables are for those who write them."""
    code = (
        "import sys, sim.artefacts.store; "
        "print([name for name in sys.modules if name.partition('.')[0] == 'lark' or name.startswith('sim.lab')])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert found.stdout == "[]\n"
