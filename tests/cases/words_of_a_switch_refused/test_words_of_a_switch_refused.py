"""EIN/AUS, RUN/STOP, Marcia/Fermo were refused row by row, without a word on what would be accepted."""

from pathlib import Path

import pytest

from sim.lab.recordings import ColumnMap, load_traces

TABLE = {"format": "wide", "temperature": "T", "clock": {"column": "t", "formats": ["seconds"]}}


def load(folder: Path, running: str, resting: str, **keys: object) -> tuple[list[float], list[str]]:
    path = folder / "a.csv"
    path.write_text(f"t,T,M\n0,20,{resting}\n1,21,{running}\n2,22,{resting}\n", encoding="utf-8")
    signals = {"T": {}, "M": keys or {"boolean": True}}
    (trace,), report = load_traces(path, ColumnMap.model_validate({**TABLE, "signals": signals}))
    return trace.signals["M"].tolist(), report.sentences()


@pytest.mark.parametrize(
    ("on", "off"),
    [
        ("EIN", "AUS"), ("RUN", "STOP"), ("Marcia", "Fermo"), ("Vero", "Falso"), ("ON", "OFF"), ("Wahr", "Falsch"),
        ("VRAI", "FAUX"), ("Ja", "Nein"), ("Running", "Stopped"), ("Marche", "Arrêt"), ("-1", "0"), ("1,0", "0,0"),
    ],
)  # fmt: skip
def test_common_words_need_no_declaring(tmp_path: Path, on: str, off: str) -> None:
    values, _ = load(tmp_path, on.replace(",", "."), off.replace(",", "."))
    assert values == [0.0, 1.0, 0.0]


def test_any_words_can_be_declared_and_make_the_signal_a_switch(tmp_path: Path) -> None:
    values, said = load(tmp_path, "In Lavoro", "attesa", on="in lavoro", off=["Attesa", "Ferma"])
    assert values == [0.0, 1.0, 0.0] and len(said) == 2  # the rows used, and the signal that the alphabet lacks
    assert load(tmp_path, "on", "off", on="off", off="on")[0] == [1.0, 0.0, 1.0]  # contacts that open


def test_the_refusal_lists_once_what_is_accepted_and_how_to_declare_others(tmp_path: Path) -> None:
    _, said = load(tmp_path, "In lavoro", "Attesa", on="Gira")
    about = [line for line in said if "words of M that are accepted" in line]
    assert len(about) == 1 and "Gira" in about[0] and "ein" in about[0] and 'M = { on = ["..."]' in about[0]


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"on": "X", "off": "x"}, "'x' stands in both on and off"),
        ({"on": "X", "boolean": False}, "leave out boolean = false"),
    ],
)
def test_words_that_contradict_are_refused(tmp_path: Path, keys: dict[str, object], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        load(tmp_path, "X", "Y", **keys)
