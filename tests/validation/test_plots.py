"""Pictures: whatever the curves are, a whole picture comes out, and nothing in it lies over something else."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from sim.lab.pictures import Curve, Picture, draw
from sim.sha.trace import UNKNOWN, Event

EPOCH = 1_700_000_000.0
NOTHING = np.array([])


def wave(rows: int, label: str = "measured", step: float = 2.0) -> Curve:
    times = EPOCH + step * np.arange(rows)
    values = 40.0 + 5.0 * np.sin(np.arange(rows) / 20.0)
    return Curve(label, times, values, values - 1.0, values + 1.0)


def full(rows: int = 600) -> Picture:
    """Everything that a picture can have."""
    curve = wave(rows)
    events = [Event(EPOCH + 60.0 * n, symbol) for n, symbol in enumerate(["W_ON", "A_1", UNKNOWN, "A_0"])]
    return Picture(
        "model along trace",
        curve,
        predicted=wave(rows, "predicted"),
        open_loop=wave(rows, "free run"),
        ahead=wave(rows, "forecast 5 min before"),
        inputs=[wave(rows, f"Input{n}") for n in range(3)],
        events=events,
        outages=[(EPOCH + 200.0, EPOCH + 300.0)],
        limit=44.0,
        note="SYNTHETIC: not measured on a plant",
        units={"Input0": "A"},
    )


def nans(curve: Curve) -> Curve:
    holes = np.full(curve.times.shape, np.nan)
    return Curve(curve.label, curve.times, holes, holes, holes)


ODD = {
    "everything": full(),
    "an empty curve": Picture("empty", Curve("measured", NOTHING, NOTHING)),
    "empty curves beside it": Picture(
        "e", wave(50), predicted=Curve("p", NOTHING, NOTHING, NOTHING, NOTHING), inputs=[Curve("i", NOTHING, NOTHING)]
    ),
    "a single point": Picture("point", wave(1), predicted=wave(1, "predicted"), limit=80.0),
    "two points": Picture("points", wave(2), open_loop=wave(2, "free run")),
    "only NaN": Picture("nan", nans(wave(50)), predicted=nans(wave(50, "predicted")), limit=80.0),
    "no events": Picture("quiet", wave(50), inputs=[wave(50, "Assorbimento")]),
    "outage from start to end": Picture("out", nans(wave(50)), outages=[(EPOCH, EPOCH + 100.0)]),
    "one value throughout": Picture("flat", Curve("m", EPOCH + np.arange(9.0), np.full(9, 20.0)), limit=-5.0),
    "letters that no font has": Picture("Temp 𝛼", wave(9, "𝛼"), note="𝛼"),
    "dollars and underscores": Picture("cost$_a$ of \\x", wave(9, "_T$x$"), note="50 % $"),
}


@pytest.mark.parametrize("picture", ODD.values(), ids=ODD.keys())
def test_whatever_the_curves_are_a_picture_comes_out(picture: Picture, tmp_path: Path) -> None:
    written = draw(picture, tmp_path / "new folder" / "p.png")
    pixels = imread(written)
    assert pixels.shape[0] > 500 and pixels.shape[1] > 1000
    assert pixels[..., :3].std() > 0.01


def drawn(picture: Picture, path: Path, monkeypatch: pytest.MonkeyPatch) -> Figure:
    """The figure behind the file."""
    figures: list[Figure] = []
    savefig = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: (figures.append(self), savefig(self, *a, **k)))
    draw(picture, path)
    return figures[0]


def test_title_note_and_legends_lie_over_no_curve_and_not_over_one_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = drawn(full(), tmp_path / "p.png", monkeypatch)
    axes, legends = figure.axes, [axis.get_legend() for axis in figure.axes[:2]]
    boxes = [legend.get_window_extent() for legend in legends if legend is not None]
    boxes += [text.get_window_extent() for text in figure.texts]
    boxes += [axis.get_window_extent() for axis in axes]
    assert len(boxes) == 7
    overlaps = [(a, b) for n, a in enumerate(boxes) for b in boxes[n + 1 :] if a.padded(-2).overlaps(b.padded(-2))]
    assert overlaps == []
    assert all(figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1 for box in boxes)


def test_a_limit_far_away_is_named_and_does_not_press_the_curves_flat(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    near = drawn(Picture("near", wave(100), limit=46.0), tmp_path / "a.png", monkeypatch)
    assert near.axes[0].get_ylim()[1] >= 46.0
    assert near.axes[0].get_legend_handles_labels()[1] == ["measured", "limit 46 °C"]
    monkeypatch.undo()
    far = drawn(Picture("far", wave(100), limit=300.0), tmp_path / "b.png", monkeypatch)
    assert far.axes[0].get_ylim()[1] < 50.0
    assert [text.get_text() for text in far.axes[0].texts] == ["limit 300 °C, above this range"]


def test_no_line_is_drawn_across_a_gap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    times = EPOCH + np.concatenate([np.arange(0.0, 100.0), np.arange(400.0, 500.0)])
    gappy = Curve("free run", times, np.full(200, 30.0))
    figure = drawn(Picture("gap", wave(10), open_loop=gappy), tmp_path / "p.png", monkeypatch)
    line = figure.axes[0].lines[1]
    assert np.isnan(np.asarray(line.get_ydata(), dtype=float)).sum() == 1


@pytest.mark.parametrize(("step", "unit"), [(2.0, "minutes"), (60.0, "hours"), (3600.0, "days")])
def test_the_time_axis_is_in_a_unit_that_suits_the_span(
    step: float, unit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figure = drawn(Picture("span", wave(500, step=step)), tmp_path / "p.png", monkeypatch)
    assert figure.axes[-1].get_xlabel() == f"{unit} since the first row"


def test_more_inputs_than_colours_are_all_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    many = [wave(20, f"Input{n}") for n in range(11)]
    figure = drawn(Picture("many", wave(20), inputs=many), tmp_path / "p.png", monkeypatch)
    assert len(figure.axes[1].lines) == 11


@pytest.mark.parametrize("name", ["picture", "picture.docx", "picture.jpeg2"])
def test_a_name_that_is_no_picture_is_refused(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"cannot be a picture; give a name that ends in \.png"):
        draw(full(), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ending", [".png", ".PNG", ".pdf", ".svg"])
def test_each_ending_gives_its_own_kind_of_file(ending: str, tmp_path: Path) -> None:
    starts = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
    content = draw(Picture("kind", wave(20)), tmp_path / f"p{ending}").read_bytes()
    assert content.startswith(starts[ending.lower()])


def test_a_picture_is_there_as_a_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_self: object, file: Path, **_options: object) -> None:
        file.write_bytes(b"\x89PNG")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("matplotlib.figure.Figure.savefig", full)
    with pytest.raises(OSError, match="No space left"):
        draw(Picture("title", Curve("T", np.arange(3.0), np.arange(3.0))), tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []
