"""`decanter model export`: files, sentences, exit codes."""

import json
import stat
import sys
from pathlib import Path

import pytest

from sim.lab.formats.find import find_model
from sim.lab.formats.write_model import write_model_directory
from sim.lab.uppaal import document
from sim.lab.uppaal.rules import check_rules
from tests.cli.support import decanter, misused, refused
from tests.uppaal.support import learned


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model directory and two traces."""
    folder = tmp_path_factory.mktemp("export")
    write_model_directory(folder / "model", learned("lsha"))
    assert decanter("trace", "synth", "cd1", "cd8", "--out", folder / "traces").exit_code == 0
    return folder


def test_each_trace_gets_its_four_files(place: Path) -> None:
    out = place / "out"
    result = decanter("model", "export", place / "model", "--uppaal", "--trace", place / "traces", "--out", out)
    assert result.exit_code == 0, result.output
    names = {path.name for path in out.iterdir()}
    assert names == {f"decanter_{cd}{end}" for cd in ("cd1", "cd8") for end in (".xml", ".q", "_val.xml", "_val.q")}
    for path in out.glob("*.xml"):
        queries = path.with_suffix(".q").read_text(encoding="utf-8").splitlines()
        formulas = [line for line in queries if line and not line.startswith("//")]
        assert formulas and check_rules(path.read_text(encoding="utf-8"), formulas) == []


def test_json_says_what_was_written_and_a_query_is_added(place: Path) -> None:
    result = decanter(
        "model", "export", place / "model", "--uppaal", "--trace", place / "traces" / "cd1.csv", "--out", place / "j",
        "--query", "E[<=100; 50](max: Temp)", "--json",
    )  # fmt: skip
    row = json.loads(result.stdout)["traces"][0]
    assert (row["trace"], row["accepted"], row["comparison"]) == ("cd1", True, [])
    assert "E[<=100; 50](max: m_1.Temp)" in (place / "j" / "decanter_cd1.q").read_text(encoding="utf-8")


def test_a_template_of_ones_own_is_filled_in_without_reaching_anything_else(place: Path, tmp_path: Path) -> None:
    own = tmp_path / "own.xml"
    shipped = (Path(document.__file__).parent / "templates" / "system.xml").read_text(encoding="utf-8")
    command = ("model", "export", place / "model", "--uppaal", "--trace", place / "traces" / "cd1.csv")
    with_own = (*command, "--template", own, "--out", tmp_path / "o")
    own.write_text(
        shipped.replace("<nta>", "<nta>\n\t<!-- of the {{ system.templates | length }} -->"), encoding="utf-8"
    )
    assert decanter(*with_own).exit_code == 0
    made = (tmp_path / "o" / "decanter_cd1.xml").read_text(encoding="utf-8")
    assert decanter(*command, "--out", tmp_path / "p").exit_code == 0
    plain = (tmp_path / "p" / "decanter_cd1.xml").read_text(encoding="utf-8")
    (line,) = set(made.splitlines()) - set(plain.splitlines())
    assert line.strip() in ("<!-- of the 2 -->", "<!-- of the 3 -->") and made.replace(f"{line}\n", "") == plain
    for text, words in (
        ("{% for x in %}", "line 1 of the template: "),
        (shipped.replace("system.title", "system.tittle"), "has no attribute 'tittle'"),
        ("{{ system.__class__.__mro__ }}", "unsafe"),
        (f"{shipped}{{{{ ''.join(range(10 ** 9)) }}}}", "cannot be filled in"),
        (shipped.replace("</nta>", "", 1), "XML: the document is not well-formed"),
        ("{{ doctype | safe }}<nta/>", "cd1"),
    ):
        own.write_text(text, encoding="utf-8")
        refused(decanter(*with_own), 2, words)
    refused(
        decanter(*command, "--template", tmp_path / "none.xml", "--out", tmp_path / "q"), 2, "none.xml", "no such file"
    )
    misused(
        decanter("model", "export", place / "model", "--artefacts", "--template", own, "--out", tmp_path), "--uppaal"
    )


def test_without_an_engine_the_files_stand_and_its_absence_is_one_sentence(
    place: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("DECANTER_VERIFYTA", raising=False)
    result = decanter(
        "model", "export", place / "model", "--uppaal", "--trace", place / "traces", "--out", tmp_path / "o", "--run"
    )
    assert result.exit_code == 1
    assert result.stderr.count("\n") == 1 and "no verifyta here" in result.stderr
    assert len(list((tmp_path / "o").iterdir())) == 8


def test_with_an_engine_its_answers_stand_beside_ours(place: Path, tmp_path: Path) -> None:
    engine = tmp_path / "verifyta"
    engine.write_text(
        f"#!{sys.executable}\n"
        "import sys\n"
        "for number, line in enumerate(open(sys.argv[-1]), 1):\n"
        "    if line.strip() and not line.startswith('//'):\n"
        "        print(f'Verifying formula {number} at {sys.argv[-1]}:{number}\\n-- Formula is satisfied.')\n"
        "        if line.startswith('E['):\n"
        "            print('(1000 runs) E(max) = 500 ± 0.25 (95% CI)')\n",
        encoding="utf-8",
    )
    engine.chmod(engine.stat().st_mode | stat.S_IXUSR)
    arguments = ("model", "export", place / "model", "--uppaal", "--trace", place / "traces" / "cd8.csv")
    done = decanter(*arguments, "--out", tmp_path, "--verifyta", engine, "--json")
    assert done.exit_code == 0, done.output
    rows = {row["quantity"]: row for row in json.loads(done.stdout)["traces"][0]["comparison"]}
    assert rows["A<> p_1.next_i == N_E"]["agree"] is True
    hottest = next(row for name, row in rows.items() if "max: m_1.Temp" in name)
    assert hottest["agree"] is False and hottest["uppaal"] == 500 and hottest["native"] < 100
    shown = decanter(*arguments, "--out", tmp_path, "--verifyta", engine)
    assert "native against UPPAAL" in shown.stdout and "NO" in shown.stdout


def test_artefacts_are_written_and_can_be_read_again(place: Path, tmp_path: Path) -> None:
    result = decanter("model", "export", place / "model", "--artefacts", "--out", tmp_path / "a")
    assert result.exit_code == 0, result.output
    written = find_model(tmp_path / "a" / "decanter")
    assert len(written.structure.locations) == len(learned("lsha").sha.locations)
    assert len(written.structure.edges) == len(learned("lsha").sha.edges)


def test_wrong_use_and_wrong_input_are_one_sentence_each(place: Path, tmp_path: Path) -> None:
    model, traces = place / "model", place / "traces"
    misused(decanter("model", "export", model, "--out", tmp_path), "--uppaal")
    misused(decanter("model", "export", model, "--uppaal", "--out", tmp_path), "--trace")
    given = ("model", "export", model, "--uppaal", "--trace", traces)
    refused(decanter("model", "export", tmp_path / "none", *given[3:], "--out", tmp_path), 2, "none")
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="utf-8")
    assert decanter(*given, "--out", blocked / "x").exit_code == 2
    result = decanter(*given, "--out", tmp_path / "q", "--query", "Pr[<=9.5](<> Temp > 30)")
    assert result.exit_code == 2 and "whole seconds" in result.stderr
