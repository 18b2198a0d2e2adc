"""What a diagnosis writes: the stable document, the report, the pictures, and a folder that is never half."""

import json
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from math import inf, nan
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from gateway.console import Rows
from gateway.lab.gap.diagnose import DiagnosisResult, show
from sim.artefacts.model_directory import read_model_directory
from sim.lab.discrepancy import advice_lines, beginning_sentence, held_out_sentence
from sim.lab.discrepancy.diagnosis import Diagnosis, Verdict
from sim.lab.discrepancy.heat_maps import heat_map, span
from sim.lab.discrepancy.output import folder as output_folder
from sim.lab.discrepancy.output.diagnosis_json import MISSING_HEAT_FILE, document, document_text
from sim.lab.discrepancy.output.folder import check_folder, write_diagnosis
from sim.lab.discrepancy.output.pictures import (
    CYCLES,
    ERRORS,
    MISSING,
    SHEET,
    WHERE,
    cycles_to_show,
    draw,
    draw_missing_heat,
)
from sim.lab.discrepancy.output.report import Occasion, place_sentence, report_html
from sim.lab.discrepancy.story import verdict_sentence
from tests.discrepancy_report.made_diagnoses import EVIL, LATE, PLACE, beginning, course, missing, of
from tests.gateway.support import two_modes

VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
KEYS = ["verdict", "effects", "parameter_shift", "unexplained", "localisation", "held_out", "model_before"]
EFFECT_KEYS = ["name", "class", "confidence", "gain_nats", "parameters", "needs", "distinguish_by"]


def occasion(folder: Path, verification: tuple[str, ...] | None = None, name: str = "plant") -> Occasion:
    facts = {"model": "plant", "seed": "0"}
    roles = {"pump": "MarciaPmpFango"}
    return Occasion(name, "TCuscinettiRiduttore", "2026-01-01 00:00 UTC", facts, roles, folder, "", verification)


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> dict[Verdict, dict[str, Path]]:
    """The pictures of each verdict's diagnosis, drawn once."""
    home = tmp_path_factory.mktemp("drawn")
    for verdict in VERDICTS:
        (home / verdict).mkdir()
    return {verdict: draw(of(verdict), "a title", home / verdict) for verdict in ("agree", "named", "too-little-data")}


def html_of(
    diagnosis: Diagnosis, verification: tuple[str, ...] | None = None, pictures: Mapping[str, Path] | None = None
) -> str:
    return report_html(diagnosis, occasion(Path("out"), verification), pictures or {})


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Empty files for pictures, where the folder is what matters."""

    def sketch(diagnosis: Diagnosis, title: str, folder: Path) -> dict[str, Path]:
        names = () if diagnosis.course is None else (MISSING, WHERE, CYCLES, ERRORS, SHEET)
        for name in names:
            (folder / name).touch()
        return {name: folder / name for name in names}

    monkeypatch.setattr(output_folder, "draw", sketch)


def flat(html: str) -> str:
    """The text of a page without its markup, blanks made one."""

    class Text(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.parts: list[str] = []
            self.hidden = False

        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            self.hidden = tag == "style"
            wanted = {name: value or "" for name, value in attrs}
            for name in ("src", "href"):
                assert wanted.get(name, "data:").startswith("data:"), wanted

        def handle_data(self, data: str) -> None:
            if not self.hidden:
                self.parts.append(data)

    parser = Text()
    parser.feed(html)
    return " ".join(" ".join(parser.parts).split())


# -------------------------------------------------------------------- the document


@pytest.mark.parametrize("verdict", VERDICTS)
def test_what_is_named_has_a_share_of_none_of_these_and_nothing_else_has(verdict: Verdict) -> None:
    made, page = document(of(verdict)), flat(html_of(of(verdict)))
    assert ("none_of_these" in made) == bool(made["effects"]) == ("none of these" in page)
    if made["effects"]:
        assert made["none_of_these"] == 0.02 and "2 % none of these" in page
        assert made["effects"][0]["confidence"] + made["none_of_these"] <= 1.0


def test_the_sentence_of_a_name_says_how_sure_it_is_and_how_likely_none_of_these_is() -> None:
    sure = replace(of("named").effects[0], confidence=0.93)
    said = {
        share: verdict_sentence(
            "named",
            (sure,),
            unexplained=(),
            shifts=(),
            held=None,
            cycles=11,
            unit="°C",
            none_of_these=share,
        )
        for share in (0.05, 0.002)
    }
    assert said[0.05].endswith("while it runs), 0.93; none of these 0.05.")
    assert said[0.002].endswith("0.93; none of these below 0.01.")
    either = replace(sure, members=("pump-cooling", "feed-temperature-coupling"))
    said_of_class = verdict_sentence(
        "class", (either,), unexplained=(), shifts=(), held=None, cycles=11, unit="°C", none_of_these=0.05
    )
    assert said_of_class.endswith("pump-cooling or feed-temperature-coupling, 0.93; none of these 0.05.")


@pytest.mark.parametrize("verdict", VERDICTS)
def test_the_document_has_the_keys_of_the_interface_for_every_verdict(verdict: Verdict) -> None:
    made = json.loads(document_text(of(verdict)), parse_constant=pytest.fail)
    assert list(made)[:8] == [*KEYS, "model_after"] and made["verdict"] == verdict
    assert (made["model_after"] is not None) == bool(made["effects"]) == (verdict in ("named", "class"))
    for effect in made["effects"]:
        assert list(effect)[:7] == EFFECT_KEYS and effect["class"][0] == effect["name"]
        assert effect["needs"] == ["MarciaPmpFango"]
    for place in (*made["localisation"], *made["unexplained"]):
        low, high = place["seconds"]
        assert 0 <= low < high and place["cycles"].count("/") == 1
        assert {"location", "after", "correlates", "share", "p"} <= set(place)
    for shift in made["parameter_shift"]:
        assert {"location", "parameter", "change", "sigma"} <= set(shift)


def test_the_document_has_null_where_a_number_is_none() -> None:
    odd = replace(of("named"), settings={"threshold": nan, "seed": np.float64(3.0)}, ceiling_after=None)
    made = document(odd)
    assert made["settings"] == {"threshold": None, "seed": 3.0}
    assert [one["gain_nats"] for one in made["candidates"]][-1] is None
    assert "NaN" not in document_text(odd) and "Infinity" not in document_text(odd)


def test_a_span_without_an_end_goes_to_the_longest_time_seen_there() -> None:
    whole = course()
    since = np.where(np.array(whole.location) == "OFF/0-100", whole.since_event * 3.0, whole.since_event)
    made = document(replace(of("named"), course=replace(whole, since_event=since)))
    (late,) = [place for place in made["localisation"] if place["location"] == LATE.location]
    assert late["seconds"] == [1800.0, float(since[np.array(whole.location) == "OFF/0-100"].max())]


def test_the_document_names_the_table_of_the_missing_heat_which_has_every_window(
    tmp_path: Path, sketched: None
) -> None:
    out = tmp_path / "out"
    write_diagnosis(of("agree"), occasion(out), None, report=False)
    made = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    header, *rows = (out / made["missing_heat"]).read_text(encoding="utf-8").splitlines()
    heat = missing(course(after=False))
    assert header == "time,mean,low,high,running,held_out" and len(rows) == heat.times.size
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    columns = (heat.times, heat.mean, heat.low, heat.high, heat.running, heat.held_out)
    np.testing.assert_allclose(table, np.column_stack(columns), rtol=1e-5, atol=1e-3)
    write_diagnosis(of("too-little-data"), occasion(out), None, report=False)
    assert [path.name for path in out.iterdir()] == ["diagnosis.json"]
    assert json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))["missing_heat"] is None


# -------------------------------------------------------------------- what is said of held-out cycles


def test_both_errors_before_the_floor_and_what_is_gone_are_said_in_one_sentence() -> None:
    said = held_out_sentence(of("named"))
    assert (
        document(of("named"))["held_out"]["sentence"]
        == said
        == (
            "4 cycles, free-run error 0.700 °C as given, 0.630 °C refitted, 0.225 °C with what was added; noise floor "
            "0.200 °C (99 % interval 0.160 to 0.250), from what equal cycles differ by; 97% of the excess removed "
            "(95 % interval 90% to 100%)"
        )
    )
    assert held_out_sentence(of("agree")).endswith("differ by") and "added" not in held_out_sentence(of("agree"))
    assert held_out_sentence(of("too-little-data")) == ""


def proved(diagnosis: Diagnosis, **changed: Any) -> Diagnosis:
    """The diagnosis with other figures of its held-out cycles."""
    assert diagnosis.held_out is not None
    return replace(diagnosis, held_out=replace(diagnosis.held_out, **changed))


def test_no_more_than_all_of_the_excess_is_gone_and_pieces_are_told_from_cycles() -> None:
    odd = proved(of("named"), excess_removed=1.0, ci95=(0.97, 1.0), cycles=1, pieces=6)
    page, line = flat(html_of(odd, ())), held_out_sentence(odd)
    assert "all of the excess removed, to within the floor (95 % interval 97% to 100%)" in line
    assert "1 cycle in 6 independent pieces" in line and "1 cycle in 6 independent pieces was fitted by neither" in page
    assert "all of it is gone, to within the floor" in page and "held-out cycles, 6 independent pieces" in page
    assert "whole pieces resampled" in page and "More than 100 %" not in page
    assert "0.70 °C free-run error, the model as given 0.63 °C refitted" in page
    assert "noise floor 0.200 °C (99 % interval 0.160 to 0.250), from what equal cycles differ by" in page


def test_a_name_whose_shrinking_is_not_shown_says_so() -> None:
    shown = of("named")
    unsure = replace(shown, effects=tuple(replace(one, shrinking_shown=False) for one in shown.effects))
    unsure = proved(unsure, ci95=(-0.2, 1.0))
    assert held_out_sentence(unsure).endswith("(95 % interval -20% to 100%): the shrinking is not shown")
    assert "the shrinking is not shown" in flat(html_of(unsure, ()))
    assert "shrinking is not shown" not in flat(html_of(shown, ())) + held_out_sentence(shown)
    none = proved(unsure, excess_removed=None, ci95=None)
    assert "no excess over the floor" in held_out_sentence(none)


# -------------------------------------------------------------------- the map


def test_the_map_has_the_mean_heat_where_it_was_put() -> None:
    found = heat_map(course(after=False))
    assert found is not None and found.after is None
    hot = found.locations.index("ON/200-300")
    assert np.nanmean(found.before[hot]) == pytest.approx(40.0, abs=1.5)
    others = np.delete(found.before, hot, axis=0)
    assert np.nanmax(np.abs(others)) < 10.0
    assert found.columns[0] == "0–60 s" and len(found.columns) == found.before.shape[1] == len(found.edges) - 1


def test_a_mean_over_one_or_two_cycles_does_not_set_the_colours() -> None:
    whole = course()
    spike = np.where((whole.cycle == 3) & (whole.since_event < 130) & (whole.heat_before < 20), 900.0, nan)
    names = np.array(whole.location)
    lone = np.where(np.isfinite(spike), "ON/300+", names)
    found = heat_map(replace(whole, heat_before=np.fmax(whole.heat_before, spike), location=tuple(lone.tolist())))
    assert found is not None and "ON/300+" in found.locations
    assert np.nanmax(found.before) > 800 and found.largest < 60


def test_windows_without_heat_or_before_the_first_start_make_no_map() -> None:
    whole = course()
    nothing = np.full(whole.times.size, nan)
    assert heat_map(replace(whole, heat_before=nothing)) is None
    assert heat_map(replace(whole, since_event=np.full(whole.times.size, 1e9))) is None


def test_spans_are_told_in_seconds_minutes_and_without_end() -> None:
    assert span(0, inf) == "any time"
    assert [span(0, 60), span(120, 300), span(3600, inf), span(0, 240)] == [
        "0–60 s",
        "2–5 min",
        "over 60 min",
        "0–4 min",
    ]


def test_the_cycles_drawn_are_held_out_ones_or_all_where_none_is() -> None:
    assert cycles_to_show(course()) == [7, 8, 9, 10]
    assert cycles_to_show(course(cycles=20, held_out=12), most=3) == [8, 14, 19]
    assert cycles_to_show(course(cycles=3, held_out=0)) == [0, 1, 2]


# -------------------------------------------------------------------- pictures and report


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_a_report_that_says_it_first_and_needs_nothing_from_outside(
    verdict: Verdict, drawn: dict[Verdict, dict[str, Path]]
) -> None:
    diagnosis = of(verdict)
    html = html_of(diagnosis, () if diagnosis.effects else None, drawn.get(verdict, drawn["agree"]))
    said = flat(html)
    assert said.index(diagnosis.sentence) < said.index("What to do next")
    assert "://" not in html and "<script" not in html
    assert html.count("data:image/png;base64,") == (0 if verdict == "too-little-data" else 4)
    assert ("model version promote STORE --add" in said) == bool(diagnosis.effects)
    assert ("Before and after on held-out cycles" in said) == bool(diagnosis.effects)


def test_the_report_names_class_rivals_experiment_and_what_was_not_tested() -> None:
    said = flat(html_of(of("class"), ()))
    assert "pump-cooling (class: pump-cooling, feed-temperature-coupling)" in said
    assert "cannot tell it from feed-temperature-coupling" in said
    assert "Somewhat alike in these data: wear-drift" in said
    assert "run for half an hour at one load with the pump on, then off" in said
    assert "ambient-coupling no trace has a signal for the role" in said
    assert "97 % of it is gone (95 % interval 90 % to 100 %" in said


def test_page_and_terminal_print_a_moment_as_its_date() -> None:
    found = of("named")
    for name, params in (("sensor-offset-step", {"size": 0.5, "at": 1.743e9}), ("wear-drift", {"since": 1.743e9})):
        one = replace(found, effects=(replace(found.effects[0], name=name, members=(name,), params=params),))
        shown = DiagnosisResult(one, None, None)
        rows = next(part for part in show(shown, Path("out")) if isinstance(part, Rows) and "added" in part.title)
        for text in (flat(html_of(one)), str(rows.rows)):
            assert "2025-03-26 14:40 UTC" in text and "e+09" not in text


def test_the_report_says_when_the_new_model_will_not_be_promoted() -> None:
    said = flat(html_of(of("named"), ("growth refuted: it can reach 700 degC",)))
    assert "does not verify" in said and "it can reach 700 degC" in said


def test_an_agreeing_diagnosis_shows_shifts_and_no_second_curve() -> None:
    said = flat(html_of(of("agree")))
    assert "Parameters that moved" in said and "+5.0 %" in said
    assert "of the excess removed" not in said


def test_nothing_from_a_file_is_markup_or_a_formula(tmp_path: Path) -> None:
    nasty = replace(course(), location=(EVIL,) * course().times.size)
    effects = tuple(replace(one, signals={"pump": EVIL}, plain=EVIL) for one in of("named").effects)
    odd = replace(of("named"), sentence=EVIL, course=nasty, effects=effects, untested={EVIL: EVIL}, reasons=(EVIL,))
    html = report_html(odd, occasion(tmp_path, (), EVIL), draw(odd, EVIL, tmp_path))
    assert "<script" not in html and "&lt;script&gt;alert(1)" in html


def test_pictures_are_drawn_of_what_there_is(drawn: dict[Verdict, dict[str, Path]]) -> None:
    assert set(drawn["named"]) == set(drawn["agree"]) == {MISSING, WHERE, CYCLES, ERRORS, SHEET}
    assert drawn["too-little-data"] == {}
    files = [path.read_bytes() for verdict in ("named", "agree") for path in drawn[verdict].values()]
    assert all(content.startswith(b"\x89PNG") and len(content) > 8_000 for content in files)


def test_the_sheet_is_the_pictures_themselves_one_below_the_other(drawn: dict[Verdict, dict[str, Path]]) -> None:
    pixels = {name: imread(path) for name, path in drawn["named"].items()}
    sheet, below = pixels.pop(SHEET), 0
    for each in pixels.values():
        height, width = each.shape[:2]
        found = (row for row in range(below, len(sheet) - height + 1) if (sheet[row, :width] == each[0]).all())
        below = next(row for row in found if (sheet[row : row + height, :width] == each).all()) + height
    assert below <= len(sheet)


def test_the_missing_heat_comes_first_then_sentence_place_names_and_shrinking() -> None:
    picture = Path(__file__)  # any bytes will do
    page = html_of(of("named"), (), {MISSING: picture, WHERE: picture})
    order = [
        page.index("What is missing over time"),
        page.index(of("named").sentence),
        page.index("Where the unexplained heat is"),
        page.index("What was added to the model"),
        page.index("Before and after on held-out cycles"),
        page.index("What to do next"),
    ]
    assert order == sorted(order)
    before = flat(page[: page.index(of("named").sentence)])
    assert "pump-cooling" not in before and "is missing over time" in before


def test_a_place_with_less_than_a_fifth_of_the_heat_is_none_that_is_told() -> None:
    little = replace(PLACE, share=0.19)
    odd = replace(of("unexplained"), places=(little, LATE), unexplained=(little,))
    page = flat(html_of(odd))
    assert "of the unexplained heat is in" not in page and "in no particular place" in page
    assert "19 %" in page  # the table has every place
    assert advice_lines(odd) == ("what is not recorded yet: no measured signal goes with the gap",)
    told = replace(odd, unexplained=(replace(little, share=0.2),))
    assert "20% of the unexplained heat is in ON/200-300" in flat(html_of(told))
    for share, said in ((0.19, "in no particular place"), (0.2, "20% of the unexplained heat is in ON/200-300")):
        sentence = verdict_sentence(
            "unexplained",
            (),
            unexplained=(replace(little, share=share),),
            shifts=(),
            held=None,
            cycles=11,
            unit="°C",
            began=beginning(),
        )
        assert said in sentence and beginning_sentence(beginning(), "°C") in sentence


def test_since_when_it_errs_is_said_once_and_drawn_with_its_interval() -> None:
    began = beginning()
    said = beginning_sentence(began, "°C")
    assert said == (
        "It begins with the cycle of 2023-11-15 10:13 UTC (between 2023-11-15 07:13 UTC and 2023-11-15 10:13 UTC): "
        "since then the machine is 1.2 °C warmer while it runs than before (4 cycles before, 7 after)."
    )
    odd = replace(of("unexplained"), began=began)
    assert flat(html_of(odd)).count(said) == 1
    assert flat(html_of(replace(odd, sentence=f"A gap. {said}"))).count(said) == 1
    figure = Figure()
    axis = figure.subplots()
    assert odd.missing_heat is not None
    draw_missing_heat(axis, odd.missing_heat, began, "degC")
    labels = axis.get_legend_handles_labels()[1]
    assert labels[-1] == "begins 2023-11-15 10:13 UTC (95 % interval)" and "at rest" in labels
    (line,) = [one for one in axis.lines if one.get_label() == labels[-1]]
    assert np.asarray(line.get_xdata())[0] == pytest.approx(began.time / 86_400.0)
    plain = Figure().subplots()
    draw_missing_heat(plain, odd.missing_heat, None, "degC")
    assert not [name for name in plain.get_legend_handles_labels()[1] if name.startswith("begins")]


def test_a_place_is_told_in_one_sentence() -> None:
    assert place_sentence(PLACE, "°C") == (
        "62% of the unexplained heat is in ON/200-300, 0–4 min after W_ON: the plant makes 38 °C/h too much for the "
        "model there, in 9 of 11 cycles (p = 0.001); it goes with MarciaPmpFango"
    )


# -------------------------------------------------------------------- the folder


def test_a_diagnosis_replaces_an_earlier_one_and_leaves_other_files_alone(tmp_path: Path, sketched: None) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine", encoding="utf-8")
    write_diagnosis(of("named"), occasion(out, ()), two_modes())
    assert read_model_directory(out / "model").sha.name == "two modes"
    first = sorted(path.name for path in out.iterdir())
    written = ["model", "diagnosis.json", "report.html", MISSING_HEAT_FILE, MISSING, WHERE, CYCLES, ERRORS, SHEET]
    assert first == sorted(["notes.txt", *written])
    check_folder(out, tmp_path / "given")
    write_diagnosis(of("too-little-data"), occasion(out), None)
    assert sorted(path.name for path in out.iterdir()) == ["diagnosis.json", "notes.txt", "report.html"]


def test_a_folder_that_cannot_take_the_result_is_refused_before_any_work(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ValueError, match="this is a file"):
        check_folder(tmp_path / "file", tmp_path / "m")
    with pytest.raises(ValueError, match="no folder can be written there"):
        check_folder(tmp_path / "file" / "deeper", tmp_path / "m")
    (tmp_path / "model").mkdir()
    with pytest.raises(ValueError, match="is not from a diagnosis"):
        check_folder(tmp_path, tmp_path / "m")
    with pytest.raises(ValueError, match="would replace the one that is diagnosed"):
        check_folder(tmp_path, tmp_path / "model")


def test_a_failure_while_writing_leaves_the_earlier_diagnosis_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sketched: None
) -> None:
    out = tmp_path / "out"
    write_diagnosis(of("named"), occasion(out, ()), two_modes())
    before = (out / "diagnosis.json").read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(output_folder, "write_model_directory", full)
    with pytest.raises(OSError, match="No space"):
        write_diagnosis(of("class"), occasion(out, ()), two_modes())
    assert (out / "diagnosis.json").read_bytes() == before and (out / "model" / "model.json").is_file()
    assert not [path for path in out.iterdir() if path.name.startswith(".")]
