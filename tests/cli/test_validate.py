"""`decanter model judge validation`: nine stages seen, each bad artefact and trace its sentence, nothing lost."""

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result

from sim.lab.formats.find import find_model
from sim.lab.judge.discovery import discover, own_check, read_own_report
from sim.lab.judge.output_folder import read_results
from tests.cli.artefact_set import EDGES, FLOWS, HISTOGRAM, REPORT, THESIS, files, source, written
from tests.cli.support import DATA, decanter, misused, only_object, refused
from tests.rig.no_bands import without_bands

QUICK = ("--runs", 200, "--no-pictures", "--jobs", 1)


def validate(model: object, traces: object, out: Path, *more: object) -> Result:
    return decanter("model", "judge", "validation", model, "--traces", traces, "--out", out, *QUICK, *more)


def stage(out: Path, place: str, number: int) -> dict[str, Any]:
    (file,) = (out / place).glob(f"{number:02d}_*.json")
    return dict(json.loads(file.read_text(encoding="utf-8")))


# ---------------------------------------------------------------- a campaign that works


@pytest.fixture(scope="module")
def done(model: Path, traces: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """A campaign of one model under both semantics along two traces, with pictures."""
    out = tmp_path_factory.mktemp("campaign") / "out"
    options = ("--semantics", "both", "--runs", 300, "--jobs", 1, "--training", traces)
    result = decanter("model", "judge", "validation", model, "--traces", traces, "--out", out, *options)
    assert result.exit_code == 0, result.output
    return out, result


def test_each_of_the_nine_stages_is_in_the_log_and_in_the_folder(done: tuple[Path, Result]) -> None:
    out, result = done
    lines = (out / "campaign.log").read_text(encoding="utf-8").splitlines()
    assert {int(line.split()[0]) for line in lines} == set(range(1, 10))
    assert all(line in result.stdout for line in lines)
    for number in range(1, 10):
        record = stage(out, "decanter", number)
        assert record["stage"] == number and record["found"] and record["seconds"] >= 0
    assert {one["file"] for one in stage(out, "decanter", 1)["files"]} >= {"model.json", "flow_conditions.txt"}
    assert len(stage(out, "decanter", 8)["traces"]) == 4


def test_results_are_in_json_and_csv_with_the_figures_of_each_trace_and_semantics(done: tuple[Path, Result]) -> None:
    out, _ = done
    found = read_results(out)
    assert [(one.trace, one.semantics) for one in found] == [
        (trace, semantics) for semantics in ("carried", "resampled") for trace in ("cd1", "cd17")
    ]
    assert all(one.synthetic and one.accepted and not one.failure for one in found)
    for one in found:
        assert 0 < one.mae.low <= one.mae.value <= one.mae.high and one.crps > 0 and 0 <= one.coverage <= 1
    with (out / "results.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["mae"]) for row in rows] == [one.mae.value for one in found]
    assert [float(row["dense_rmse"]) for row in rows] == [one.dense.rmse for one in found]


def test_carried_temperature_is_the_better_semantics_on_these_traces_and_the_report_says_by_how_much(
    done: tuple[Path, Result],
) -> None:
    out, result = done
    by = {(one.trace, one.semantics): one.mae.value for one in read_results(out)}
    assert all(by[trace, "carried"] < by[trace, "resampled"] for trace in ("cd1", "cd17"))
    sentence = "carried is better on 1 of 1 traces (unseen)"  # cd17 was in the training
    assert sentence in result.stdout and sentence in (out / "decanter" / "report.html").read_text(encoding="utf-8")


def test_each_trace_has_a_picture_as_png_and_pdf_and_the_report_holds_them(done: tuple[Path, Result]) -> None:
    out, _ = done
    names = sorted(path.name for path in (out / "decanter" / "pictures").iterdir())
    expected = [f"{trace}.{semantics}.{end}" for trace in ("cd1", "cd17") for semantics in ("carried", "resampled")
                for end in ("pdf", "png")]  # fmt: skip
    assert names == expected
    report = (out / "decanter" / "report.html").read_text(encoding="utf-8")
    assert report.count("data:image/png;base64,") == 4 and "SYNTHETIC" in report
    assert "SYNTHETIC" in (out / "index.html").read_text(encoding="utf-8")


def test_a_complete_campaign_says_so_last_and_is_not_written_over_unasked(
    done: tuple[Path, Result], model: Path, traces: Path, tmp_path: Path
) -> None:
    out, _ = done
    assert json.loads((out / "campaign.json").read_text(encoding="utf-8"))["state"] == "complete"
    before = (out / "results.json").read_bytes()
    refused(validate(model, traces, out), 2, "complete campaign", "--overwrite")
    assert (out / "results.json").read_bytes() == before


def test_json_is_one_object_with_summaries_gains_and_verdicts(model: Path, traces: Path, tmp_path: Path) -> None:
    data = only_object(validate(model, traces / "cd1.csv", tmp_path / "out", "--json", "--semantics", "both").stdout)
    assert [one["semantics"] for one in data["summaries"]] == ["carried", "resampled"]
    assert "MAE" in data["gains"]["decanter"]["sentence"]
    assert {one["verdict"]["word"] for one in data["results"]} <= {"good", "review"}


def test_several_models_share_the_traces_and_get_a_report_each_and_one_index(
    model: Path, traces: Path, tmp_path: Path
) -> None:
    out, small = tmp_path / "out", written(tmp_path / "set", files())
    result = decanter("model", "judge", "validation", model, model, small, "--traces", traces, "--out", out, *QUICK)
    assert result.exit_code == 0
    index = (out / "index.html").read_text(encoding="utf-8")
    places = sorted(path.name for path in out.iterdir() if path.is_dir())
    assert len(places) == 3 and "SMALL" in places
    assert all(f"{place}/report.html" in index and (out / place / "report.html").is_file() for place in places)
    first, second = (
        {one.trace: one.mae.value for one in read_results(out) if one.model == name}
        for name in list(dict.fromkeys(one.model for one in read_results(out)))[:2]
    )
    assert first == second  # the same model twice: the deterministic figures agree
    assert sum("files read" in line for line in result.stdout.splitlines()) == 1


def test_overwriting_removes_what_the_earlier_campaign_left_and_nothing_else(
    model: Path, traces: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert validate(written(tmp_path / "set", files()), traces, out).exit_code == 0
    (out / "my notes.txt").write_text("mine", encoding="utf-8")
    (out / "SMALL" / "mine.txt").write_text("mine", encoding="utf-8")
    assert validate(model, traces, out, "--overwrite").exit_code == 0
    assert (out / "decanter" / "report.html").is_file()
    assert [path.name for path in (out / "SMALL").iterdir()] == ["mine.txt"] and (out / "my notes.txt").is_file()


def test_a_model_that_is_not_there_is_learned_by_the_method_of_its_name(
    traces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The bands, for which a model is fitted three times more: a campaign's runs do not look at them.
    without_bands(monkeypatch)
    out = tmp_path / "out"
    result = validate("bins", traces, out, "--training", traces, "--semantics", "both")
    assert result.exit_code == 0
    assert {(one.model, one.semantics, one.trace) for one in read_results(out)} == {
        ("bins", semantics, trace) for semantics in ("carried", "resampled") for trace in ("cd1", "cd17")
    }
    assert "In-sample" in (out / "bins" / "report.html").read_text(encoding="utf-8")
    assert stage(out, "bins", 1)["directory"] == str(out / "learned" / "bins")
    again = tmp_path / "again"  # what was learned is a model as any other
    assert validate(out / "learned" / "bins", traces / "cd1.csv", again).exit_code == 0
    same = {one.trace: one.mae.value for one in read_results(out) if one.semantics == "carried"}
    assert [one.mae.value for one in read_results(again)] == [same["cd1"]]
    refused(validate("bins", traces, tmp_path / "none"), 2, "bins: there is no such model", "--training")
    assert not (tmp_path / "none").exists()


def test_the_report_of_a_model_of_our_own_is_held_against_its_laws(done: tuple[Path, Result], model: Path) -> None:
    assert "against model.json, all agree" in stage(done[0], "decanter", 3)["found"]
    own, beside = find_model(model).runnable(), read_own_report(discover(model))
    assert beside is not None
    report, histogram = beside
    law, *others = report.distributions
    wrong = replace(report, distributions=(replace(law, mean=1234.5), *others))
    found = own_check(wrong, histogram, own)
    assert "1 disagree" in found.sentence and "the report 1234.5" in found.sentence
    without = own_check(replace(report, distributions=tuple(others)), histogram, own)
    assert law.name in without.sentence and "only one of" in without.sentence


def test_stage_3_reads_the_report_and_not_what_model_json_says_too(model: Path, tmp_path: Path) -> None:
    """A source has an edge for each location and symbol: parsing it took 90 s for a model of 303 locations."""
    own = tmp_path / "own"
    shutil.copytree(model, own)
    (own / "decanter_source.txt").write_text("this is no DOT", encoding="utf-8")
    beside = read_own_report(discover(own))
    assert beside is not None
    assert own_check(*beside, find_model(model).runnable()).sentence.endswith("all agree")


def test_names_from_outside_are_text_everywhere_and_lead_nowhere(model: Path, traces: Path, tmp_path: Path) -> None:
    where, out = tmp_path / "t", tmp_path / "out"
    where.mkdir()
    names = ["<script>alert(1)<\\script> & \"q\" 'x'", "日本 é $x_2$", "=cmd|calc", "new\nline", "x" * 200, "..a"]
    for name in names:
        (where / f"{name}.csv").write_bytes((traces / "cd1.csv").read_bytes())
    document = (model / "model.json").read_text(encoding="utf-8").replace('"ON/0-100"', '"<script>2&\'../..  $x$"')
    (tmp_path / "model.json").write_text(document, encoding="utf-8")
    result = decanter(
        "model",
        "judge",
        "validation",
        tmp_path / "model.json",
        "--traces",
        where,
        "--out",
        out,
        "--runs",
        100,
        "--jobs",
        1,
    )
    assert result.exit_code == 0
    assert {one.trace for one in read_results(out)} >= set(names[:5])
    for page in out.rglob("*.html"):
        assert "<script" not in page.read_text(encoding="utf-8")
    assert all(out in file.resolve().parents for file in out.rglob("*"))
    assert len(list(out.rglob("*.png"))) == len(read_results(out))


# ---------------------------------------------------------------- artefacts, good and bad


def test_public_artefacts_run_and_their_rates_are_cross_checked(traces: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = validate(written(tmp_path / "set", files()), traces, out)
    assert result.exit_code == 0 and "all agree" in stage(out, "SMALL", 3)["found"]
    assert all(one.accepted and not one.failure for one in read_results(out))


def test_lines_of_the_thesis_run_as_they_are_written_and_carried_on_request(traces: Path, tmp_path: Path) -> None:
    small = written(tmp_path / "set", {**files(), "SMALL.txt": THESIS})
    (small.parent / "flow_conditions.txt").unlink()
    assert validate(small, traces, tmp_path / "written").exit_code == 0
    assert {one.semantics for one in read_results(tmp_path / "written")} == {"resampled"}
    assert validate(small, traces, tmp_path / "both", "--semantics", "both").exit_code == 0
    assert {one.semantics for one in read_results(tmp_path / "both")} == {"carried", "resampled"}


def test_symbols_that_are_uppaals_channel_names_are_understood(traces: Path, tmp_path: Path) -> None:
    named = {"A_0": "a__0_100", "A_1": "a__100_200", "A_2": "a__200_300", "A_3": "a__300_plus"}
    edges = [(start, named.get(symbol, symbol), end) for start, symbol, end in EDGES]
    small = written(tmp_path / "set", {**files(), "SMALL_source.txt": source(edges)})
    assert validate(small, traces, tmp_path / "out").exit_code == 0
    assert all(one.accepted for one in read_results(tmp_path / "out"))


def test_119_appended_runs_are_counted_and_the_one_that_the_report_describes_is_used(
    traces: Path, tmp_path: Path
) -> None:
    other = "D_0:\n0.5\nD_1:\n0.7\n"
    appended = (HISTOGRAM + other) * 59 + HISTOGRAM
    small = written(tmp_path / "set", {**files(), "SMALL_histogram_values.txt": appended})
    assert validate(small, traces, tmp_path / "out").exit_code == 0
    found = stage(tmp_path / "out", "SMALL", 3)
    assert "119 runs appended, 2 different" in found["found"] and "all agree" in found["found"]
    assert [law["mean"] for law in found["cross_check"]["laws"]] == pytest.approx([0.001, 0.002])


def test_a_report_that_disagrees_with_its_histogram_is_told_and_the_model_runs(traces: Path, tmp_path: Path) -> None:
    small = written(tmp_path / "set", {**files(), "SMALL.txt": REPORT.replace("D_1(0.002000)", "D_1(0.003000)")})
    result = validate(small, traces, tmp_path / "out")
    assert result.exit_code == 0
    told = "D_1: the mean of its 2 values is 0.002, the report says 0.003"
    assert told in result.stdout
    assert any(told in one for one in stage(tmp_path / "out", "SMALL", 3)["cross_check"]["disagreements"])


Spoil = Callable[[dict[str, str]], dict[str, str]]


def replaced(name: str, text: str) -> Spoil:
    return lambda content: {**content, name: text}


def without(name: str) -> Spoil:
    return lambda content: {key: text for key, text in content.items() if key != name}


def cubic(content: dict[str, str]) -> dict[str, str]:
    spoiled = {**content, "SMALL.txt": THESIS.replace("linear(alpha=0.005)", "cubic(alpha=0.005)")}
    return without("flow_conditions.txt")(spoiled)


def renamed(old: str, new: str) -> Spoil:
    return lambda content: {(new if key == old else key): text for key, text in content.items()}


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (without("SMALL.txt"), ("SMALL.txt is missing",)),
        (without("SMALL_source.txt"), ("no model directory, store, file or set of artefacts",)),
        (renamed("SMALL.txt", "Small.txt"), ("SMALL.txt is missing", "Small.txt", "upper and lower case")),
        (
            renamed("SMALL_histogram_values.txt", "small_histogram_values.txt"),
            ("SMALL_histogram_values.txt is missing", "upper and lower case"),
        ),
        (renamed("SMALL_source.txt", "small_source.txt"), ("SMALL_source.txt is missing", "upper and lower case")),
        (replaced("SMALL_source.txt", source(EDGES)[:700]), ("SMALL_source.txt:",)),
        (replaced("SMALL_source.txt", ""), ("SMALL_source.txt",)),
        (replaced("SMALL_histogram_values.txt", HISTOGRAM + "nan\n"), ("SMALL_histogram_values.txt:7", "nan")),
        (replaced("SMALL.txt", REPORT.replace("0.002000", "nan")), ("SMALL.txt:", "nan")),
        (replaced("flow_conditions.txt", "0\n(x0)' = = 3\n"), ("flow_conditions.txt:2",)),
    ],
    ids=[
        "missing report", "missing source", "report in another case", "histogram in another case",
        "source in another case", "truncated DOT", "empty DOT", "NaN in the histogram", "NaN in the report",
        "an equation that is none",
    ],
)  # fmt: skip
def test_artefacts_that_cannot_be_read_are_one_sentence_before_anything_is_written(
    spoil: Spoil, words: tuple[str, ...], traces: Path, tmp_path: Path
) -> None:
    small = written(tmp_path / "set", spoil(files()))
    refused(validate(small, traces, tmp_path / "out"), 2, *words)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (without("flow_conditions.txt"), "there is no flow_conditions.txt"),
        (replaced("flow_conditions.txt", FLOWS.replace("(x0 - 45)", "(x0 - 45)^2")), "quadratic"),
        (replaced("flow_conditions.txt", FLOWS[: FLOWS.index("1\n(x0)")]), "flow 1"),
        (cubic, "'cubic' is unknown"),
        (replaced("SMALL_source.txt", source([*EDGES, ("q_0", "A_1", "q_1")])), "not deterministic"),
        (replaced("SMALL.txt", REPORT.replace("D_1(0.002000)\n", "")), "D_1 is not in the report"),
    ],
    ids=["no flow file", "unknown flow", "a flow that is missing", "unknown flow in a line", "non-deterministic",
         "a law that is missing"],
)  # fmt: skip
def test_artefacts_that_cannot_run_are_checked_against_the_traces_and_the_report_says_why_nothing_is_simulated(
    spoil: Spoil, words: str, traces: Path, tmp_path: Path
) -> None:
    small, out = written(tmp_path / "set", spoil(files())), tmp_path / "out"
    result = validate(small, traces, out)
    assert result.exit_code == 1 and "Traceback" not in result.output
    assert words in result.stderr and words in stage(out, "SMALL", 4)["found"]
    assert all(one.stage == 4 and one.accepted and one.events and words in one.failure for one in read_results(out))
    assert all(stage(out, "SMALL", number) for number in range(1, 10))
    report = (out / "SMALL" / "report.html").read_text(encoding="utf-8")
    assert "Not simulated" in report and stage(out, "SMALL", 6)["traces"][0]["accepted"]


def test_one_model_that_cannot_run_does_not_stop_the_other(model: Path, traces: Path, tmp_path: Path) -> None:
    small = written(tmp_path / "set", without("flow_conditions.txt")(files()))
    result = decanter(
        "model", "judge", "validation", small, model, "--traces", traces, "--out", tmp_path / "out", *QUICK
    )
    assert result.exit_code == 0
    assert [bool(one.failure) for one in read_results(tmp_path / "out")] == [True, True, False, False]


def test_a_missing_edge_is_named_with_its_location_and_symbol(traces: Path, tmp_path: Path) -> None:
    edges = [edge for edge in EDGES if edge != ("q_1", "A_2", "q_1")]
    small = written(tmp_path / "set", {**files(), "SMALL_source.txt": source(edges)})
    assert validate(small, traces, tmp_path / "on").exit_code == 0
    assert "'A_2' in 'q_1'" in stage(tmp_path / "on", "SMALL", 6)["found"]
    result = validate(small, traces, tmp_path / "off", "--policy", "reject")
    assert result.exit_code == 1 and "'A_2'" in result.stderr and "'q_1'" in result.stderr


# ---------------------------------------------------------------- traces and folders that cannot be used


def test_traces_that_cannot_be_used_are_one_sentence(model: Path, wrong: Path, tmp_path: Path) -> None:
    (tmp_path / "none").mkdir()
    out = tmp_path / "out"
    refused(validate(model, tmp_path / "none", out), 2, "no CSV file")
    refused(validate(model, wrong / "folder", out), 2, "no CSV file")
    refused(validate(model, wrong / "cold.csv", out), 2, "cold.csv", "TCuscinettiRiduttore")
    refused(validate(model, wrong / "garbage", out), 2, "garbage")
    assert not out.exists()


def test_a_bad_trace_among_good_ones_is_a_failed_row_at_stage_5(model: Path, traces: Path, tmp_path: Path) -> None:
    folder = tmp_path / "mixed"
    folder.mkdir()
    (folder / "good.csv").write_bytes((traces / "cd1.csv").read_bytes())
    header = "time,MarciaDecanter,Assorbimento,TCuscinettiRiduttore\n"
    (folder / "one.csv").write_text(header + "0,1,150,20\n", encoding="utf-8")
    (folder / "nan.csv").write_text(header + "".join(f"{row},1,150,nan\n" for row in range(9)), encoding="utf-8")
    (folder / "cold.csv").write_text("time,MarciaDecanter,Assorbimento\n0,1,10\n1,1,12\n", encoding="utf-8")
    (folder / "empty.csv").touch()
    assert validate(model, folder, tmp_path / "out").exit_code == 0
    found = {one.trace: one for one in read_results(tmp_path / "out")}
    assert set(found) == {"good", "one", "nan", "cold", "empty"} and not found["good"].failure
    assert all(found[name].stage == 5 and found[name].failure for name in ("one", "nan", "cold", "empty"))
    assert "one reading" in found["one"].failure


def test_folders_that_cannot_take_results_are_one_sentence_and_stay_as_they_are(
    model: Path, traces: Path, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    refused(validate(model, traces, tmp_path / "file"), 2, "this is a file")
    refused(validate(model, traces, tmp_path / "file" / "out"), 2, "cannot be written")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.docx").touch()
    refused(validate(model, traces, tmp_path / "full", "--overwrite"), 2, "thesis.docx", "other things")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.docx"]


def test_a_model_or_a_map_that_is_not_there_is_one_sentence(model: Path, traces: Path, tmp_path: Path) -> None:
    refused(validate(tmp_path / "none", traces, tmp_path / "out"), 2, "none")
    refused(validate(model, traces, tmp_path / "out", "--map", "none"), 2, "column map")


def test_an_interrupted_campaign_is_seen_as_such_and_can_be_replaced(
    model: Path, traces: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        patch.setattr("sim.lab.judge.campaign.index_html", killed)
        decanter_result = validate(model, traces, out)
    assert decanter_result.exit_code == 130
    assert f"what was done lies in {out}" in decanter_result.stderr
    assert json.loads((out / "campaign.json").read_text(encoding="utf-8"))["state"] == "running"
    assert not (out / "index.html").exists() and read_results(out)
    refused(validate(model, traces, out), 2, "unfinished campaign")
    assert validate(model, traces, out, "--overwrite").exit_code == 0


# ---------------------------------------------------------------- the real public artefacts


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("hri_3b/HRI_SIM_3b", "119 runs appended, 10 different"),
        ("hri_3a/HRI_SIM_3a", "no flow_conditions.txt"),
        ("made/ENERGY_MADE_1", "quadratic"),
        ("THERMO_UPPAAL_1", "no flow_conditions.txt"),
    ],
)
def test_the_public_artefacts_go_through_their_stages_and_have_no_edge_for_decanter_events(
    name: str, words: str, traces: Path, tmp_path: Path
) -> None:
    place = DATA / "lsha_upstream" / "artefacts" / name
    if not place.parent.is_dir():
        pytest.skip(f"{place.parent} is not there")
    out = tmp_path / "out"
    result = validate(place, traces, out)
    assert result.exit_code == 1 and words in result.stdout
    assert all(stage(out, Path(name).name, number) for number in range(1, 10))
    assert not any(one.accepted for one in read_results(out))


def test_validate_explains_itself_and_refuses_wrong_usage(model: Path, traces: Path) -> None:
    for flag in ("-h", "--help"):
        said = decanter("model", "judge", "validation", flag)
        assert said.exit_code == 0 and "nine stages" in " ".join(said.stdout.split())
    misused(decanter("model", "judge", "validation", model, "--traces", traces), "--out")
    misused(decanter("model", "judge", "validation", "--traces", traces, "--out", "x"), "MODEL")
    misused(validate(model, traces, traces / "out", "--runs", 5), "--runs")


def test_progress_and_colour_stay_off_where_there_is_no_terminal(model: Path, traces: Path, tmp_path: Path) -> None:
    result = validate(model, traces / "cd1.csv", tmp_path / "out")
    assert result.stderr == "" and "\x1b" not in result.stdout
