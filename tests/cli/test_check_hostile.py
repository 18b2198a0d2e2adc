"""`decanter model check` on hostile queries: one clear sentence each, with its place; no traceback, no endless work."""

import tracemalloc
from pathlib import Path

import pytest
from click.testing import Result

from tests.cli.support import decanter, only_object, refused

DEEP = "(" * 10_000 + "Temp > 80" + ")" * 10_000

UNREADABLE = (
    ("", "the query is empty"),
    ("   \t\n ", "the query is empty"),
    ("\x00", "column 1: found '\\x00'"),
    ("Pr", "ends too early"),
    ("Pr[", "right would be '<='"),
    ("Pr[<=", "right would be a number"),
    ("Pr[<=60", "right would be ']' or ';'"),
    ("Pr[<=60]", "right would be '('"),
    ("Pr[<=60](<>", "ends too early"),
    ("Pr[<=60](<> )", "column 13: found ')'"),
    ("Pr[<=60](<> Temp >", "ends too early"),
    ("Pr[<=60](<> Temp > 80", "right would be ')'"),
    ("Pr[<=60](<> Temp > 80))", "column 23: found ')'"),
    ("Pr[<=60]<> Temp > 80", "column 9: found '<>'"),
    ("Pr(<=60)(<> Temp > 80)", "column 4: found '<='"),
    ("pr[<=60](<> Temp > 80)", "a query begins with Pr, not with pr"),
    (" PR [<=60](<> Temp > 80)", "column 2: a query begins with Pr, not with PR"),
    ("e[<=60; 5](max: Temp)", "a query begins with E, not with e"),
    ("SIMULATE [<=60; 5] {Temp}", "a query begins with simulate"),
    ("a[] ON_0_100", "a query begins with A"),
    ("Pr[<=60](<> Témp > 80)", "column 13: 'Témp' is not known; did you mean Temp?"),
    ("Pr[<=60](<> 温度 > 80)", "column 13: '温度' is not known; known are Temp"),
    ("Pr[<=60](<> Temp > 80) 🔥", "column 24: found '🔥'"),
    ("Pr[<=60](<> Temp > 80)\u202e", "column 23: found '\\u202e'"),
    ("Pr[<=1e400](<> Temp > 80)", "column 6: a run of inf s cannot be made"),
    ("Pr[<=1e-400](<> Temp > 80)", "column 6: a run of 0 s cannot be made"),
    ("Pr[<=0](<> Temp > 80)", "column 6: a run of 0 s cannot be made"),
    ("Pr[<=-5](<> Temp > 80)", "column 6: a run of -5 s cannot be made"),
    ("Pr[<=nan](<> Temp > 80)", "column 6: found 'nan'; right would be a number"),
    ("Pr[<=inf](<> Temp > 80)", "column 6: found 'inf'"),
    ("Pr[<=60](<> Temp > 1e400)", "column 20: 1e400 is beyond"),
    ("Pr[<=60](<> Temp > nan)", "column 20: 'nan' is not known"),
    ("Pr[<=60; 0](<> Temp > 80)", "column 10: 0 is no number of runs"),
    ("Pr[<=60; -1](<> Temp > 80)", "column 10: -1 is no number of runs"),
    ("Pr[<=60; 1.5](<> Temp > 80)", "column 10: 1.5 is no number of runs"),
    (f"Pr[<=60; {'9' * 400}](<> Temp > 80)", "column 10: 999"),
    ("E[<=60; 0](max: Temp)", "column 9: 0 is no number of runs"),
    ("E[<=60](max: Temp)", "the mean of how many runs?"),
    ("E[<=60; 10](mean: Temp)", "column 13: found 'mean'; right would be 'max' or 'min'"),
    ("E[<=60; 10](max: Temp > 80)", "column 18: a condition stands where a number is needed"),
    ("E[<=60; 10](max: ON_0_100)", "column 18: ON_0_100 is a location"),
    ("E[<=60; 10](max: Temp / 0)", "column 25: a division by zero"),
    (DEEP, "the query is a condition alone"),
    (f"Pr[<=60](<> {'(' * 10_000}", "ends too early"),
    (f"Pr[<=60](<> {'(' * 200_000}", "50000 is the most"),
    (f"Pr[<=60](<> {'!' * 10_000}ON_0_100)", "300 is the most"),
    (f"Pr[<=60](<> {'-' * 10_000}Temp > 3)", "300 is the most"),
    (f"Pr[<=60](<> Temp > {'9' * 40_000})", "is beyond what a number can be"),
    (f"Pr[<=60](<> {'a' * 40_000} > 3)", "column 13: 'aaa"),
    (f"Pr[<=60](<> Temp {'+ 1 ' * 200}> 3)", "300 is the most"),
    ("Pr[<=60](<> nowhere)", "column 13: 'nowhere' is not known"),
    ("Pr[<=60](<> on_200_300)", "did you mean ON_200_300"),
    ("Pr[<=60](<> ON_200_30)", "did you mean ON_200_300"),
    ("Pr[<=60](<> ON/200-300)", "column 13: 'ON' is not known; did you mean ON_"),
    ("Pr[<=60](<> temp > 80)", "did you mean Temp?"),
    ("Pr[<=60](<> m_2.Temp > 80)", "column 13: found 'm_2.Temp'"),
    ("Pr[<=60](<> at 'ON/200-30')", "column 13: no location is called 'ON/200-30'; did you mean ON/200-300"),
    ('Pr[<=60](<> at "")', "no location is called ''"),
    ("Pr[<=60](<> at 'x)", "column 16"),
    ("Pr[<=60](<>[30,10] Temp > 80)", "column 12: [30,10] is no interval"),
    ("Pr[<=60](<>[-3,10] Temp > 80)", "column 12: [-3,10] is no interval"),
    ("Pr[<=60](<>[0,61] Temp > 80)", "column 12: 61 s is beyond the run"),
    ("Pr[<=60](<>[0,1e400] Temp > 80)", "column 12: [0,inf] is no interval"),
    ("Pr[<=60](<>[nan,5] Temp > 80)", "column 13: found 'nan'"),
    ("Pr(<>[0,0] Temp > 80)", "the interval ends at 0"),
    ("Pr(<> Temp > 80)", "how long is a run?"),
    ("Pr[<=60](Temp > 80)", "column 19: found ')'"),
    ("Pr[<=60](<> Temp)", "column 13: Temp is a number"),
    ("Pr[<=60](<> 80)", "column 13: a number stands where a condition is needed"),
    ("Pr[<=60](<> Temp > 80) >= 1.5", "column 27: 1.5 is no probability"),
    ("Pr[<=60](<> Temp > 80) >= -1", "column 27: -1 is no probability"),
    ("Pr[<=60](<> Temp > 80) >= 1e400", "column 27: inf is no probability"),
    ("Pr[<=60](<> Temp > 80) > 0.5", "column 24: found '>'"),
    ("Pr[<=60](<> Temp = 80)", "numbers are compared with =="),
    ("Pr[<=60](<> Temp >= 80 & ON_0_100)", "'and' is written &&"),
    ("Pr[<=60](ON_0_100 --> ON_0_100)", "within what time"),
    ("Pr[<=60](ON_0_100 -->[5,1] ON_0_100)", "[5,1] is no interval"),
    ("A[] Temp <= 150", "column 5: Temp changes continuously"),
    ("E<> 1 / 0 > 1", "a division by zero"),
    ("ON_0_100 -->", "ends too early"),
    ("simulate [<=60; 3] {}", "column 21: found '}'"),
    ("simulate [<=60; 3] {Temp,}", "column 26: found '}'"),
    ("simulate [<=60; 3] {nowhere}", "column 21: 'nowhere' is not known"),
    ("__import__('os').system('id')", "column 11: found '('; no function is known here"),
    ("{{7*7}}", "column 1: found '{'"),
    ("; DROP TABLE", "column 1: found ';'"),
    ("Pr[<=60](<> Temp > 0x10)", "column 21: found 'x10'"),
    ("Pr[<=60](<> Temp > 8,5)", "column 21: found ','"),
)

UNANSWERABLE = (
    ("Pr[<=1e308](<> Temp > 80)", "at most at 1e9 s"),
    ("Pr[<=60](<> Temp * Temp > 80)", "linear in the temperature"),
    ("Pr[<=60](<> 1 / Temp > 80)", "linear in the temperature"),
    ("Pr[<=60](<> Temp / (time - time) > 80)", "linear in the temperature"),
    ("Pr[<=60; 999999999999](<> Temp > 80)", "ask for a number from 1 to 100000000"),
    ("E[<=60; 999999999999](max: Temp)", "ask for a number from 1 to 100000000"),
    ("simulate [<=60; 999999999999] {Temp}", "ask for a number from 1 to 100000000"),
    ("simulate [<=60; 100000000] {Temp}", "are too many numbers"),
    ("E[<=60; 10](max: 1 / age)", "no finite number"),
    ("E[<=60; 10](max: 1 / (Temp - Temp))", "no finite number"),
    ("simulate [<=60; 2] {1 / age}", "no finite number"),
    ("Pr[<=600000](Temp > 20 --> Temp < 10 within 1e5) >= 2", "is no probability"),
    ("Pr[<=1e9](<> Temp > 80 && time * time > 3)", "steps a run, above"),
)

STRANGE_BUT_RIGHT = (
    (f"Pr[<=60; 20](<> {DEEP})", 0.0),
    ("Pr[≤60; 20](◇ Temp ≥ 80)", 0.0),
    ("Pr[<=60; 20](<> Temp\u00a0> 80)", 0.0),
    ("Pr[<=60; 20](<> Temp > 1e308)", 0.0),
    ("Pr[<=60; 20](<> Temp * 1e308 > 1e300)", 1.0),
    ("Pr[<=1e-300; 20](<> Temp > -5)", 1.0),
    ("Pr[<=60; 20](<>[10,10] Temp > -1e9)", 1.0),
    ("Pr[<=60; 20]([][59.9999999999,60] Temp > 1)", 1.0),
    ("Pr[<=60; 20](<> Temp > 1 / (time - time))", 0.0),
    (f"Pr[<=60; 20](<> {' || '.join(f'Temp > {limit}' for limit in range(70))})", 1.0),
)


def ask(model: Path, query: str, *options: object) -> Result:
    return decanter("model", "check", model, query, "--from", "location:ON/100-200", *options)


def test_there_are_enough_of_them() -> None:
    assert len(UNREADABLE) + len(UNANSWERABLE) + len(STRANGE_BUT_RIGHT) >= 100


@pytest.mark.parametrize(("query", "words"), UNREADABLE, ids=[repr(query)[:40] for query, _ in UNREADABLE])
def test_what_cannot_be_read_gets_one_short_sentence(model: Path, query: str, words: str) -> None:
    assert len(refused(ask(model, query), 2, words)) < 420


@pytest.mark.parametrize(("query", "words"), UNANSWERABLE, ids=[query[:40] for query, _ in UNANSWERABLE])
def test_what_cannot_be_answered_gets_one_sentence_before_memory_is_taken(model: Path, query: str, words: str) -> None:
    tracemalloc.start()
    try:
        refused(ask(model, query), 2, words)
        assert tracemalloc.get_traced_memory()[1] < 100e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(("query", "share"), STRANGE_BUT_RIGHT, ids=[query[:40] for query, _ in STRANGE_BUT_RIGHT])
def test_what_is_strange_but_right_is_answered(model: Path, query: str, share: float) -> None:
    result = ask(model, query, "--json")
    assert only_object(result.stdout)["numbers"]["probability"] == share
