"""Column maps and alphabets from TOML: what is right loads, what is wrong is named in one sentence."""

import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim.lab.recordings.alphabet_table import alphabet_from_table, alphabet_to_table
from sim.lab.recordings.auto_thresholds import AutoBins, with_gap
from sim.lab.recordings.column_map import load_map
from sim.lab.recordings.traces import load_traces
from sim.sha.events import DECANTER, Bins, Switch, alphabet_symbols
from tests.validation.places import MAPS

GOOD = """
format = "wide"
temperature = "T"
[clock]
column = "t"
[signals.T]
unit = "degC"
"""


def test_the_project_has_maps_and_all_of_them_load() -> None:
    names = {path.stem for path in MAPS.glob("*.toml")}
    assert names >= {"decanter", "decanter_scada", "skab", "femto", "carobd", "made_cnc", "can_obd2"}
    for name in names:
        load_map(MAPS / f"{name}.toml")


@pytest.mark.parametrize("name", ["skab", "carobd", "can_obd2", "made_cnc"])
def test_nothing_that_is_no_bearing_is_called_one(name: str) -> None:
    column_map = load_map(MAPS / f"{name}.toml")
    assert not any("uscinett" in signal or "earing" in signal for signal in column_map.signals)


def test_the_cnc_alphabet_is_that_of_the_published_automaton() -> None:
    symbols = alphabet_symbols(load_map(MAPS / "made_cnc.toml").alphabet)
    assert symbols[:4] == ("l", "u", "i_0", "m_0") and symbols[-1] == "m_98" and len(symbols) == 102
    bins = load_map(MAPS / "made_cnc.toml").alphabet.channels[1]
    assert isinstance(bins, Bins) and bins.thresholds[66] == 6700.0


def test_an_alphabet_is_the_same_after_a_trip_through_a_table() -> None:
    for alphabet in (DECANTER, replace(DECANTER, debounce=2.0), load_map(MAPS / "made_cnc.toml").alphabet):
        assert alphabet_from_table(alphabet_to_table(alphabet), "here") == alphabet


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("channels = []", "x: the alphabet has no channel"),
        ("gap = 5.0", "x: channels: is missing; add it"),
        (
            "channels = [{kind = 'swich', signal = 's'}]",
            "x: channels[0]: 'kind' must be one of 'switch', 'bins', got {'kind': 'swich'",
        ),
        ("channels = [{kind = 'switch', signal = 's', rising = 'a', falling = 'a'}]", "symbol 'a' 2 times"),
        (
            "channels = [{kind = 'bins', signal = 's', thresholds = [1, 'b'], symbols = ['a']}]",
            "x: channels[0].thresholds[1]: must be a number, got 'b'",
        ),
        (
            "channels = [{kind = 'bins', signal = 's', thresholds = [1, 2], symbols = ['a']}]",
            "need 3 symbols; it has 1",
        ),
        (
            "channels = [{kind='bins', signal='s', thresholds={first=1, last=9, step=3},"
            " symbols={lowest='l', prefix='m'}}]",
            "x: thresholds from 1 to 9 are no whole steps of 3",
        ),
        ("gap = 0\nchannels = []", "x: gap: must be more than 0, got 0"),
    ],
)
def test_an_unusable_alphabet_table_is_named_with_its_place(text: str, sentence: str) -> None:
    with pytest.raises(ValueError, match=re.escape(sentence)):
        alphabet_from_table(tomllib.loads(text), "x")


def test_a_map_without_an_alphabet_has_the_decanters_signals_and_its_own_levels(tmp_path: Path) -> None:
    (tmp_path / "m.toml").write_text(GOOD)
    switch, bins = load_map(tmp_path / "m.toml").alphabet.channels
    assert switch == DECANTER.channels[0] and bins.signal == "Assorbimento" and isinstance(bins, AutoBins)
    for name in ("decanter", "decanter_scada"):
        assert with_gap(load_map(MAPS / f"{name}.toml").alphabet, []) == DECANTER
    own = GOOD + "[alphabet]\nchannels = [{kind = 'switch', signal = 'r', rising = 'a', falling = 'b'}]\n"
    (tmp_path / "m.toml").write_text(own)
    assert load_map(tmp_path / "m.toml").alphabet.channels == (Switch("r", "a", "b"),)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("format = ", "this is not TOML"),
        (GOOD.replace('"wide"', '"width"'), "format: must be 'wide' or 'long', got 'width'"),
        (GOOD.replace('"wide"', '"long"'), r"format 'long' needs a table \[long\]"),
        (GOOD.replace('temperature = "T"', 'temperature = "U"'), "temperature names 'U'; it must be one of T"),
        (GOOD.replace('temperature = "T"', ""), "temperature: is missing; add it"),
        (GOOD.replace('column = "t"', ""), "clock: give either column or time_of_day"),
        (
            GOOD.replace('column = "t"', 'column = "t"\ntimezone = "Mars"'),
            "clock.timezone: there is no time zone 'Mars'",
        ),
        (
            GOOD.replace('column = "t"', 'column = "t"\nformats = "sec"'),
            "clock.formats: 'sec' is no format; give 'seconds'",
        ),
        (GOOD + "scael = 2.0", "signals.T.scael: there is no such key"),
        (GOOD + 'scale = "two"', "signals.T.scale: must be a number, got 'two'"),
        (GOOD + "[derived]\nR = {signal = 'T'}", "derived.R: give either signal and above, or constant"),
        (GOOD + "[derived]\nR = {signal = 'U', above = 1}", "derived.R needs 'U'; it must be one of T"),
        (GOOD + "[derived]\nR = {eval = 'T > 1'}", "derived.R.eval: there is no such key"),
        (GOOD + "[derived]\nR = {product = ['T', 'U']}", "derived.R needs 'U'; it must be one of T"),
        (GOOD + "[derived]\nR = {product = ['T']}", "derived.R: product needs two signals or more"),
        (GOOD + "[derived]\nR = {constant = 1.0, scale = 2.0}", "derived.R: scale belongs to product"),
        (GOOD + "[effects]\nambient = 'U'", "effects.ambient names 'U'; it must be one of T"),
        (GOOD + "[effects]\ncolour = 'T'", "effects.colour: there is no such key"),
        (GOOD + "[alphabet]\nchannels = []", "alphabet: the alphabet has no channel"),
        ('encoding = "latin-99"' + GOOD, "encoding: there is no encoding 'latin-99'"),
    ],
)
def test_an_unusable_map_is_named_with_file_key_and_remedy(tmp_path: Path, text: str, sentence: str) -> None:
    path = tmp_path / "m.toml"
    path.write_text(text)
    with pytest.raises(ValueError, match=sentence) as caught:
        load_map(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_a_map_that_is_not_there_says_where_maps_are(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="there is no such column map"):
        load_map(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="cannot be read"):
        load_map(tmp_path)


def test_a_product_is_known_where_one_of_its_signals_was_read_and_the_others_hold(tmp_path: Path) -> None:
    derived = "[signals]\nT = {}\nP = {}\nR = {low = 0.0}\n[derived]\nL = {product = ['P', 'R'], scale = 0.5}\n"
    table = GOOD.replace('[signals.T]\nunit = "degC"\n', derived + "[alphabet]\ngap = 10.0\nchannels = []\n")
    table = table.replace("channels = []", "channels = [{kind = 'switch', signal = 'r', rising = 'a', falling = 'b'}]")
    table = table.replace('column = "t"', 'column = "t"\nformats = "seconds"')
    (tmp_path / "m.toml").write_text(table)
    rows = ["t,T,P,R", "0,20,4,", "1,20,,10", "2,20,,", "3,20,6,", "4,20,,-1", "5,20,7,", "6,20,,2", "60,20,,3"]
    (tmp_path / "x.csv").write_text("\n".join(rows) + "\n")
    (trace,), _ = load_traces(tmp_path / "x.csv", load_map(tmp_path / "m.toml"))
    expected = [np.nan, 20.0, np.nan, 30.0, np.nan, np.nan, 7.0, np.nan]
    np.testing.assert_array_equal(trace.signals["L"], expected)
    assert trace.bad["L"].tolist() == [number == 4 for number in range(8)]
