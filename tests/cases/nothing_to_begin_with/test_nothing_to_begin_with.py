"""From nothing: there was no first file to copy, a page nobody could follow, and no page at all beside a wheel."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.unknown_plc import write_examples
from decanter_gateway.start import DISTRIBUTION, FLOORS, stranger
from gateway.cli.setup import init as init_module
from gateway.settings import load_config
from sim.lab.recordings import load_map, load_traces
from tests.cli.support import decanter, only_object, refused

ROOT = Path(__file__).parents[3]
TEMPERATURE = "TCuscinettiRiduttore"
HEADERS = ("Data", "Stato marcia", "Corrente motore [A]", f"Linea2.{TEMPERATURE} [°C]")
RENAMED = ("--rename", "Stato marcia=MarciaDecanter", "--rename", "Corrente motore [A]=Assorbimento")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with an I/O list, a device file and a SCADA's export under the SCADA's own names."""
    monkeypatch.chdir(tmp_path)
    write_examples(tmp_path / "given")
    with (tmp_path / "export.csv").open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, delimiter=";")
        writer.writerow(HEADERS)
        for row in range(120):
            on = row // 30 % 2
            warm = f"{20 + row / 10:.1f}".replace(".", ",")
            writer.writerow(
                (f"01/03/2026 08:{row // 6:02d}:{row % 6 * 10:02d}", "MARCIA" if on else "FERMO", 120 * on + 5, warm)
            )
    return tmp_path


LIST = ("--host", "192.0.2.1", "--list", "given/io_list.csv", "--temperature", TEMPERATURE)


def test_a_list_and_an_address_become_a_folder_that_runs(here: Path) -> None:
    done = decanter(
        "init", "p", *LIST, "--shift", 1, "--order", "CDAB", "--without", "Riserva", "--trace", "export.csv", *RENAMED
    )
    assert done.exit_code == 0 and done.stderr == "", done.output
    assert sorted(path.name for path in (here / "p").iterdir()) == [
        "README.md",
        "columns.toml",
        "devices",
        "models",
        "plant.toml",
    ]
    config = load_config(here / "p" / "plant.toml")
    assert (config.model.temperature, config.alarms.tags) == (TEMPERATURE, (TEMPERATURE,))
    assert config.map.heartbeat == "PlcHeartbeat" and "Riserva" not in config.map.by_name
    assert config.map.by_name[TEMPERATURE].address == "holding:107" and config.map.by_name[TEMPERATURE].order == "CDAB"
    # A model of these signals is one that the gateway can run: each has its tag.
    column_map = load_map(here / "p" / "columns.toml")
    (trace,), _ = load_traces(here / "export.csv", column_map)
    assert column_map.temperature == TEMPERATURE and set(trace.signals) <= set(config.map.by_name)
    assert len((here / "p" / "README.md").read_text(encoding="utf-8").splitlines()) <= 12
    for line in ("decanter plc check", "decanter run", "--map columns.toml --out models/first"):
        assert line in done.stdout


def test_a_tags_name_spells_the_umlauts_that_a_column_has(here: Path) -> None:
    listed = "Name;Adresse;Typ;Einheit\nLager;40101;REAL;°C\nMotorstrom;40103;REAL;A\nMaschine_laeuft;1;BOOL;\n"
    (here / "list.csv").write_text(listed, encoding="utf-8")
    rows = [f"2026-03-01 08:{row:02d}:00;{row % 9 + 40};{30 * (row // 9 % 2)};{row // 9 % 2}" for row in range(60)]
    header = "Zeit;Lagertemperatur °C;Motorstrom A;Maschine läuft"
    (here / "umlauts.csv").write_text("\n".join([header, *rows]), encoding="cp1252")
    given = ("--host", "192.0.2.1", "--list", "list.csv", "--temperature", "Lager", "--trace", "umlauts.csv")
    done = decanter("init", "u", *given, "--heartbeat", "Maschine_laeuft")
    assert done.exit_code == 0 and done.stderr == "", done.output
    assert '"Maschine_laeuft" = { column = "Maschine läuft"' in (here / "u" / "columns.toml").read_text(
        encoding="utf-8"
    )


@pytest.mark.parametrize("device", ["decanter_plc", "decanter_canopen", "decanter_can", "given/unknown_plc.toml"])
def test_a_device_file_is_taken_over_with_what_it_names(device: str, here: Path) -> None:
    words = ("init", "p", "--device", device, "--temperature", TEMPERATURE, "--json")
    if "can" not in device.removeprefix("decanter"):
        refused_where = refused(decanter(*words[:-1]), 2, "--host HOST or --serial PATH")
        assert "terminal" in refused_where and not (here / "p").exists()
        words = (*words, "--host", "192.0.2.1")
    data = only_object(decanter(*words).stdout)
    # A bus has no address that could be asked for: what a start would refuse is said.
    missing = ["device: can: channel: is missing"] if device == "decanter_can" else []
    assert [part in said for part, said in zip(missing, data["warnings"], strict=True)] == [True] * len(missing)
    assert load_config(here / "p" / "plant.toml").map.by_name[TEMPERATURE]


def test_signals_that_are_no_tags_are_named_with_what_to_do(here: Path) -> None:
    data = only_object(decanter("init", "p", *LIST, "--trace", "export.csv", "--json").stdout)
    # One tag alone is a current in A; two say running, so that nobody knows which one it is.
    assert ["Corrente motore [A]" in each or "Stato marcia" in each for each in data["warnings"]] == [True, True]
    assert "is taken for Assorbimento, the only load" in data["warnings"][0]
    assert "is no tag of the device" in data["warnings"][1]
    assert all("--rename" in each for each in data["warnings"])
    read = load_map(here / "p" / "columns.toml")
    assert read.signal_names("Assorbimento") == ("Corrente motore [A]",)
    refused(decanter("init", "q", *LIST, "--trace", "export.csv", "--rename", "Stato marcia=Nobody"), 2, "Nobody")
    assert not (here / "q").exists()


def test_where_neither_export_nor_list_says_that_it_runs_both_make_it_of_the_current(here: Path) -> None:
    lines = (here / "export.csv").read_text(encoding="utf-8").splitlines()
    rows = [";".join(cell for place, cell in enumerate(line.split(";")) if place != 1) for line in lines]
    (here / "export.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    words = ("--trace", "export.csv", "--rename", "Corrente motore [A]=Assorbimento", "--json")
    data = only_object(decanter("init", "p", *LIST, *words).stdout)
    assert data["warnings"] == []
    column_map, config = load_map(here / "p" / "columns.toml"), load_config(here / "p" / "plant.toml")
    assert column_map.derived == config.map.derived and set(column_map.derived) == {"Running"}
    signals = {channel.signal for channel in column_map.alphabet.channels}
    assert signals == {"Running", "Assorbimento"} and signals <= set(config.map.by_name)


def test_files_that_are_there_stay_unless_they_are_to_be_replaced(here: Path) -> None:
    (here / "plant.toml").write_text("mine\n", encoding="utf-8")
    refused(decanter("init", *LIST), 2, "plant.toml", "--overwrite")
    assert sorted(path.name for path in here.iterdir()) == ["export.csv", "given", "plant.toml"]
    assert decanter("init", *LIST, "--overwrite").exit_code == 0
    assert load_config(here / "plant.toml").map.by_name
    assert not list(here.glob(".init*")) and not list(here.rglob("*.bak"))


def test_what_run_would_refuse_is_not_written(here: Path) -> None:
    (here / "bad.toml").write_text(
        '[device]\nname = "x"\ndriver = "modbus"\nhost = "h"\n[[tags]]\nname = "T"\n', encoding="utf-8"
    )
    refused(decanter("init", "p", "--device", "bad.toml"), 2, "bad.toml", "address")
    said = refused(decanter("init", "p", *LIST, "--heartbeat", "Nobody"), 2, "Nobody")
    assert ".init" not in said and not list((here / "p").glob("*.toml"))


def test_on_a_terminal_it_asks(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter(("given/io_list.csv", "192.0.2.1:1502", "export.csv", TEMPERATURE, "Assorbimento", "MarciaDecanter"))
    asked: list[str] = []

    def prompt(text: str, **_: object) -> str:
        asked.append(text)
        return next(answers)

    monkeypatch.setattr(init_module, "terminal", lambda: True)
    monkeypatch.setattr("click.prompt", prompt)
    done = decanter("init", "p")
    assert done.exit_code == 0, done.output
    assert len(asked) == 6 and "address" in asked[1] and "current" in asked[4]
    config = load_config(here / "p" / "plant.toml")
    assert dict(config.links[0].settings)["port"] == 1502
    assert set(load_map(here / "p" / "columns.toml").signals) <= set(config.map.by_name)


# ------------------------------------------------------------------ the pages


def test_pages_are_printed_and_their_examples_copied(here: Path) -> None:
    pages = only_object(decanter("docs", "--json").stdout)["pages"]
    assert pages["tutorial"].startswith("Tutorial") and len(pages) > 25
    for name in ("tutorial", "tutorial.md", "docs/tutorial.md", "TUTORIAL"):
        assert decanter("docs", name).stdout.strip() == (ROOT / "docs/tutorial.md").read_text(encoding="utf-8").strip()
    assert decanter("docs", "1").stdout.startswith("# 0001") or "0001" in decanter("docs", "1", "--json").stdout
    refused(decanter("docs", "toturial"), 2, "did you mean 'tutorial'")
    refused(decanter("docs", "../README"), 2, "no such page")
    assert decanter("docs", "--examples", "e").exit_code == 0 and (here / "e" / "io_list.csv").exists()
    refused(decanter("docs", "--examples", "e"), 2, "is there already")


def test_the_site_is_built_without_a_dead_link(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "site" / "search" / "search_index.json").stat().st_size > 100_000


# ------------------------------------------------------------------ whose packages


@pytest.mark.parametrize("floor", FLOORS)
def test_a_package_of_somebody_else_is_noticed_before_anything_runs(floor: str, tmp_path: Path) -> None:
    (tmp_path / floor).mkdir()
    (tmp_path / floor / "__init__.py").write_text("raise SystemExit('somebody else was run')\n", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, "-P", "-m", "decanter_gateway", "--version"],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "") and done.stderr.count("\n") == 1
    assert f"{floor!r} would be imported from {tmp_path / floor}" in done.stderr and "PYTHONPATH" in done.stderr


def test_a_package_that_was_overwritten_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert stranger(ROOT) is None
    monkeypatch.delattr("sim.DISTRIBUTION")
    assert DISTRIBUTION in str(stranger(ROOT)) and "same name" in str(stranger(ROOT))
