"""A motor of 0.8 to 3.2 A was learned with bins of 100 A: 14 of 15 locations borrowed, and nobody said a word."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from gateway.cli.main import main
from gateway.lab.traces.load import channel_warnings, load
from sim.lab.recordings import find_levels, load_map, load_traces
from sim.sha import Bins, Trace

MAP = """
format = "wide"
temperature = "T"
[clock]
column = "time"
formats = "seconds"
[signals]
T = { unit = "degC" }
"""
LEVELS = (0.1, 0.8, 2.0, 3.2)


def motor(seed: int, rows: int = 1200, noise: float = 0.05) -> np.ndarray:
    """Amperes of a small motor that rests and works at three loads, a minute or two each."""
    rng = np.random.default_rng(seed)
    level = np.repeat(rng.permutation(np.arange(rows // 60) % len(LEVELS)), 60)
    return np.asarray(np.take(LEVELS, level) + noise * rng.standard_normal(level.size))


def written(folder: Path, current: str, running: str) -> Path:
    amperes = motor(0)
    lines = [f"time,T,{current},{running}"]
    heat = 20.0
    for second, ampere in enumerate(amperes.tolist()):
        heat += (20.0 + 15.0 * ampere - heat) / 300.0
        lines.append(f"{second},{heat:.3f},{ampere:.3f},{int(ampere > 0.4)}")
    path = folder / "motor.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def warnings(folder: Path, file: Path, text: str) -> list[str]:
    """What `model learn` warns of before it learns."""
    (folder / "m.toml").write_text(text, encoding="utf-8")
    traces, column_map = load([str(file)], str(folder / "m.toml"))
    return channel_warnings(traces, column_map.alphabet)


def test_a_map_without_thresholds_takes_the_motors_own_and_nothing_is_borrowed(tmp_path: Path) -> None:
    file = written(tmp_path, "Assorbimento", "MarciaDecanter")
    text = MAP + "Assorbimento = {}\nMarciaDecanter = { boolean = true }\n"
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    _, report = load_traces(file, load_map(tmp_path / "m.toml"))
    bins = report.alphabet.channels[1]
    assert isinstance(bins, Bins) and bins.symbols == ("A_0", "A_1", "A_2", "A_3")
    between = [(low + high) / 2 for low, high in pairwise(LEVELS)]
    assert bins.thresholds == pytest.approx(between, abs=0.1)
    assert warnings(tmp_path, file, text) == []


def test_bins_that_one_level_fills_are_named_with_thresholds_that_would_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, "Assorbimento", "MarciaDecanter")
    text = MAP + (
        "Assorbimento = {}\nMarciaDecanter = { boolean = true }\n[alphabet]\nchannels = [\n"
        '{ kind = "switch", signal = "MarciaDecanter", rising = "W_ON", falling = "W_OFF" },\n'
        '{ kind = "bins", signal = "Assorbimento", thresholds = [100, 200, 300] }]\n'
    )
    (warning,) = warnings(tmp_path, file, text)
    assert f"warning: {warning}" in capsys.readouterr().err
    assert "100.0% of 1200 readings lie in one bin, A_0" in warning and "thresholds = [" in warning


def test_a_switch_that_is_never_on_is_named(tmp_path: Path) -> None:
    file = written(tmp_path, "Assorbimento", "unused")
    text = MAP + "Assorbimento = {}\n[derived]\nMarciaDecanter = { signal = 'Assorbimento', above = 5.0 }\n"
    found = warnings(tmp_path, file, text)
    assert len(found) == 1 and "MarciaDecanter is never on" in found[0] and "derives it" in found[0]


def test_signals_of_other_names_are_told_what_the_alphabet_needs(tmp_path: Path) -> None:
    file = written(tmp_path, "I_motor", "Run")
    (tmp_path / "m.toml").write_text(MAP + "I_motor = {}\nRun = { boolean = true }\n", encoding="utf-8")
    arguments = ["--traces", str(file), "--map", str(tmp_path / "m.toml"), "--out", str(tmp_path / "model")]
    done = CliRunner().invoke(main, ["model", "learn", *arguments])
    complaints = done.stderr
    assert done.exit_code == 2 and len(complaints.splitlines()) == 1
    for words in ("MarciaDecanter, Assorbimento", "I_motor, Run, T", "channels = [{kind =", 'thresholds = "auto"'):
        assert words in complaints


def test_the_thresholds_hold_when_the_record_is_drawn_anew() -> None:
    rng = np.random.default_rng(7)
    record = motor(3, rows=2400)
    whole = find_levels([Trace("m", np.arange(record.size) * 1.0, {"I": record})], "I", 30.0).thresholds
    blocks = np.array_split(np.arange(record.size), 60)
    for _ in range(20):
        pieces = [blocks[index] for index in rng.integers(0, len(blocks), len(blocks))]
        traces = [Trace("m", rows * 1.0, {"I": record[rows]}) for rows in pieces]
        assert find_levels(traces, "I", 30.0).thresholds == pytest.approx(whole, abs=0.15)


def test_readings_that_only_scatter_are_given_no_threshold() -> None:
    rng = np.random.default_rng(1)
    for draw in (rng.normal(2.0, 0.5, 3000), rng.uniform(0.8, 3.2, 3000), np.full(3000, 2.0)):
        assert find_levels([Trace("m", np.arange(3000) * 1.0, {"I": draw})], "I", 30.0).thresholds == ()
