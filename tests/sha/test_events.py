"""The encoder's rules one by one, on rows that can be read."""

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from sim.sha.events import (
    DECANTER,
    Alphabet,
    Bins,
    Encoder,
    EncoderState,
    Switch,
    alphabet_symbols,
    check_alphabet,
    encode,
    encode_trace,
)
from sim.sha.trace import UNKNOWN, Event, Trace

RUN, AMPS = "MarciaDecanter", "Assorbimento"


def run(encoder: Encoder, *rows: tuple[float, dict[str, float | None]]) -> list[tuple[float, str]]:
    return [(event.time, event.symbol) for time, readings in rows for event in encoder.feed(time, readings)]


def test_symbols_come_in_alphabet_order() -> None:
    assert alphabet_symbols(DECANTER) == ("W_ON", "W_OFF", "A_0", "A_1", "A_2", "A_3")


def test_the_first_readings_announce_what_is_known_working_status_first() -> None:
    assert run(Encoder(DECANTER), (7.0, {AMPS: 120.0, RUN: 1.0})) == [(7.0, "W_ON"), (7.0, "A_1")]


def test_a_change_of_status_and_current_in_one_row_puts_the_status_first() -> None:
    rows = (0.0, {RUN: 1.0, AMPS: 250.0}), (1.0, {AMPS: 20.0, RUN: 0.0})
    assert run(Encoder(DECANTER), *rows)[2:] == [(1.0, "W_OFF"), (1.0, "A_0")]


@pytest.mark.parametrize(
    ("amps", "symbol"),
    [(-3.0, "A_0"), (99.999, "A_0"), (100.0, "A_1"), (200.0, "A_2"), (299.9, "A_2"), (300.0, "A_3"), (1e9, "A_3")],
)
def test_a_bin_holds_its_lower_threshold_and_not_its_upper_one(amps: float, symbol: str) -> None:
    assert run(Encoder(DECANTER), (0.0, {AMPS: amps})) == [(0.0, symbol)]


@pytest.mark.parametrize("bad", [None, nan, inf, -inf])
def test_a_bad_reading_is_unknown_at_once_and_never_off(bad: float | None) -> None:
    rows = (0.0, {RUN: 1.0, AMPS: 120.0}), (1.0, {RUN: bad}), (2.0, {RUN: bad}), (3.0, {AMPS: 120.0})
    assert run(Encoder(DECANTER), *rows)[2:] == [(1.0, UNKNOWN), (1.0, "A_1")]


def test_after_a_bad_reading_the_channel_announces_itself_again() -> None:
    rows = (0.0, {RUN: 1.0, AMPS: 120.0}), (1.0, {AMPS: None}), (2.0, {AMPS: 120.0})
    assert run(Encoder(DECANTER), *rows)[2:] == [(1.0, UNKNOWN), (1.0, "W_ON"), (2.0, "A_1")]


def test_nothing_is_said_about_what_never_was_known() -> None:
    assert run(Encoder(DECANTER), (0.0, {}), (1.0, {RUN: None}), (99.0, {AMPS: None})) == []


def test_a_gap_is_unknown_at_the_time_when_knowledge_ended_whoever_notices_it() -> None:
    by_row, by_tick = Encoder(DECANTER), Encoder(DECANTER)
    for encoder in (by_row, by_tick):
        run(encoder, (0.0, {RUN: 1.0, AMPS: 120.0}))
    assert by_tick.tick(30.0) == []
    assert by_tick.tick(31.0) == [Event(30.0, UNKNOWN)]
    assert by_tick.tick(500.0) == []
    assert run(by_row, (600.0, {AMPS: 120.0})) == [(30.0, UNKNOWN), (600.0, "A_1")]
    assert run(by_tick, (600.0, {AMPS: 120.0})) == [(600.0, "A_1")]


def test_a_gap_of_exactly_the_limit_is_no_gap() -> None:
    rows = (0.0, {RUN: 1.0}), (30.0, {}), (60.0, {})
    assert run(Encoder(DECANTER), *rows) == [(0.0, "W_ON")]


def test_a_switch_that_is_sent_on_change_stays_known_between_rows_and_not_over_a_gap() -> None:
    rows = [(10.0 * row, {AMPS: 120.0}) for row in range(1, 20)]
    assert run(Encoder(DECANTER), (0.0, {RUN: 1.0}), *rows) == [(0.0, "W_ON"), (10.0, "A_1")]
    after = run(Encoder(DECANTER), (0.0, {RUN: 1.0}), (100.0, {AMPS: 120.0}))
    assert after == [(0.0, "W_ON"), (30.0, UNKNOWN), (100.0, "A_1")], "W_ON may have ended unseen"


def test_a_level_that_is_no_longer_read_becomes_unknown_while_rows_go_on() -> None:
    rows = [(10.0 * row, {RUN: 1.0}) for row in range(1, 6)]
    assert run(Encoder(DECANTER), (0.0, {RUN: 1.0, AMPS: 120.0}), *rows)[2:] == [(30.0, UNKNOWN), (30.0, "W_ON")]


def test_hysteresis_keeps_a_bin_until_its_edge_is_passed_by_that_much() -> None:
    level = Alphabet((Bins(AMPS, (100.0, 200.0), ("A_0", "A_1", "A_2"), hysteresis=5.0),))
    amps = [99.0, 104.9, 105.0, 95.0, 94.9, 203.0, 196.0, 194.0]
    told = run(Encoder(level), *((float(row), {AMPS: value}) for row, value in enumerate(amps)))
    assert told == [(0.0, "A_0"), (2.0, "A_1"), (4.0, "A_0"), (5.0, "A_2"), (7.0, "A_1")]


def test_debounce_waits_for_a_reading_that_confirms_and_dates_the_event_there() -> None:
    slow = replace(DECANTER, debounce=2.0)
    amps = [50.0, 50.0, 50.0, 150.0, 50.0, 150.0, 150.0, 150.0]
    told = run(Encoder(slow), *((float(row), {AMPS: value}) for row, value in enumerate(amps)))
    assert told == [(2.0, "A_0"), (7.0, "A_1")], "the single 150 A at 3 s is a bounce"


def test_debounce_of_a_signal_sent_on_change_ends_by_time_alone() -> None:
    encoder = Encoder(replace(DECANTER, debounce=2.0))
    assert run(encoder, (0.0, {RUN: 1.0})) == []
    assert encoder.tick(2.0) == []
    assert encoder.tick(2.5) == [Event(2.0, "W_ON")]
    bounce = (5.0, {RUN: 0.0}), (6.0, {RUN: 1.0}), (9.0, {})
    assert run(encoder, *bounce) == []


def test_a_clock_that_is_set_back_is_unknown_and_the_encoder_goes_on_from_there() -> None:
    rows = (100.0, {RUN: 1.0, AMPS: 120.0}), (40.0, {AMPS: 120.0}), (41.0, {RUN: 1.0, AMPS: 120.0})
    assert run(Encoder(DECANTER), *rows)[2:] == [(40.0, UNKNOWN), (40.0, "A_1"), (41.0, "W_ON")]


def test_a_row_that_comes_after_its_gap_was_already_told_counts_as_set_back() -> None:
    encoder = Encoder(DECANTER)
    run(encoder, (0.0, {AMPS: 120.0}))
    assert encoder.tick(40.0) == [Event(30.0, UNKNOWN)]
    assert run(encoder, (29.0, {AMPS: 120.0})) == [(29.0, UNKNOWN), (29.0, "A_1")]


def test_full_repeats_the_level_that_is_present_and_unknown_while_nothing_is_known() -> None:
    rows = (0.0, {}), (1.0, {RUN: 1.0}), (2.0, {}), (3.0, {AMPS: 150.0}), (4.0, {AMPS: 160.0}), (5.0, {AMPS: 250.0})
    told = run(Encoder(DECANTER, "full"), *rows)
    symbols = [UNKNOWN, "W_ON", "W_ON", "A_1", "A_1", "A_2"]
    assert told == [(float(row), symbol) for row, symbol in enumerate(symbols)]


def test_a_trace_without_the_signals_of_the_alphabet_has_no_events() -> None:
    assert encode(Trace("t", np.arange(3.0), {"T": np.ones(3)}), DECANTER) == ()
    assert encode(Trace("t", np.empty(0), {}), DECANTER, "full") == ()


def test_an_alphabet_of_many_bins_is_the_same_table_only_longer() -> None:
    edges = tuple(float(edge) for edge in range(100, 10000, 100))
    cnc = Alphabet((Bins("speed", edges, ("i_0", *(f"m_{index}" for index in range(99)))),))
    rows = (0.0, {"speed": 0.3}), (5.0, {"speed": 6750.0}), (10.0, {"speed": 0.1})
    assert run(Encoder(cnc), *rows) == [(0.0, "i_0"), (5.0, "m_66"), (10.0, "i_0")]


@pytest.mark.parametrize("time", [nan, inf])
def test_a_time_that_is_no_number_is_refused(time: float) -> None:
    with pytest.raises(ValueError, match="finite"):
        Encoder(DECANTER).feed(time, {})
    with pytest.raises(ValueError, match="finite"):
        Encoder(DECANTER).tick(time)


def test_a_state_of_another_alphabet_is_refused() -> None:
    state = Encoder(DECANTER).state
    with pytest.raises(ValueError, match="2 channels, its alphabet 1"):
        Encoder(Alphabet(DECANTER.channels[:1]), state=state)
    with pytest.raises(ValueError, match="names 'X'; channel 1 has W_OFF, W_ON"):
        Encoder(DECANTER, state=replace(state, announced=("X", None)))
    with pytest.raises(ValueError, match="0 channels"):
        Encoder(DECANTER, state=EncoderState())


def bins(**changes: object) -> Alphabet:
    return Alphabet((replace(Bins("x", (1.0, 2.0), ("a", "b", "c")), **changes),))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("alphabet", "sentence"),
    [
        (Alphabet(()), "has no channel"),
        (bins(signal=""), "has no signal"),
        (bins(thresholds=(2.0, 1.0)), "'x': its thresholds must ascend, and 1 follows 2"),
        (bins(thresholds=(1.0, 1.0)), "must ascend, and 1 follows 1"),
        (bins(thresholds=(1.0, inf)), "finite"),
        (bins(symbols=("a", "b")), "2 thresholds need 3 symbols; it has 2"),
        (bins(symbols=("a", "b", "a")), "the symbol 'a' 2 times"),
        (bins(symbols=("a", "b", UNKNOWN)), "reserved"),
        (bins(symbols=("a", "b", " c")), "padded"),
        (bins(hysteresis=-1.0), "hysteresis must be 0 or more"),
        (bins(hysteresis=nan), "hysteresis must be 0 or more"),
        (Alphabet((Switch("x", "s", "s"),)), "the symbol 's' 2 times"),
        (replace(DECANTER, gap=0.0), "gap must be more than 0"),
        (replace(DECANTER, debounce=-1.0), "debounce must be 0 s or more"),
        (replace(DECANTER, uppaal=(("A_9", "a"),)), "uppaal names 'A_9'"),
    ],
)
def test_an_unusable_alphabet_is_named_with_what_would_be_right(alphabet: Alphabet, sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        check_alphabet(alphabet)
    with pytest.raises(ValueError, match=sentence):
        Encoder(alphabet)


def test_an_unknown_mode_is_refused() -> None:
    with pytest.raises(ValueError, match="must be 'filtered' or 'full'"):
        Encoder(DECANTER, "all")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("what", "alphabet", "amps", "run_", "told"),
    [
        (
            "a debounce that ends at a much later reading",
            replace(DECANTER, debounce=2.0),
            {0: 150, 7: 150},
            {},
            {7: "A_1"},
        ),
        ("a switch repeated some rows after a gap", DECANTER, {0: 150}, {0: 1, 45: 1}, {45: "W_ON"}),
        (
            "a value that moves on inside a bin and leaves the band of the last one",
            Alphabet((Bins(AMPS, (100.0, 200.0), ("A_0", "A_1", "A_2"), hysteresis=5.0),)),
            {0: 99, 1: 101, 2: 102, 4: 106, 8: 98, 9: 97, 11: 94},
            {},
            {0: "A_0", 4: "A_1", 11: "A_0"},
        ),
    ],
)
def test_batch_sees(
    what: str, alphabet: Alphabet, amps: dict[int, float], run_: dict[int, float], told: dict[int, str]
) -> None:
    times = np.array([*range(14), *range(44, 50)], dtype=float)
    signals = {
        AMPS: np.array([amps.get(int(time), nan) for time in times], dtype=float),
        RUN: np.array([run_.get(int(time), nan) for time in times], dtype=float),
    }
    events = encode(Trace(what, times, signals), alphabet)
    assert {event.time: event.symbol for event in events if event.time in told} == told


def test_a_trace_gets_the_events_of_the_alphabet_that_it_meets() -> None:
    times = np.arange(4.0)
    signals = {"MarciaDecanter": np.array([0.0, 1.0, 1.0, 1.0]), "Assorbimento": np.array([0.0, 120.0, 120.0, 220.0])}
    bare = Trace("t", times, signals)
    coarse = Alphabet((DECANTER.channels[0], Bins("Assorbimento", (150.0,), ("A_0", "A_1"))))
    before = replace(bare, events=encode(bare, coarse))
    assert before.events != encode(bare, DECANTER)
    assert encode_trace(before, DECANTER).events == encode_trace(bare, DECANTER).events == encode(bare, DECANTER)
    # Of a plant whose artefacts name no channel nothing can be made.
    assert encode_trace(before, Alphabet(())) is before


def test_events_whose_signal_a_trace_lacks_are_kept_where_they_are_of_the_alphabet() -> None:
    events = (Event(0.0, "W_ON"), Event(1.0, "A_2"), Event(2.0, UNKNOWN))
    trace = Trace("t", np.arange(4.0), {"MarciaDecanter": np.ones(4)}, events=events)
    assert encode_trace(trace, DECANTER) is trace
    foreign = replace(trace, events=(*events, Event(3.0, "A_7")))
    assert encode_trace(foreign, DECANTER).events == encode(foreign, DECANTER)
    # None that only the lacking signal could have made: these are another alphabet's.
    silent = replace(trace, events=(Event(0.0, "W_OFF"),))
    assert encode_trace(silent, DECANTER).events == encode(silent, DECANTER)
