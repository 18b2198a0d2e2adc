"""`scan units` took 131 to 137 s of a device alone on its port, and asked each who it was."""

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DeviceException, LinkDown, LinkFault, ReplyTimeout
from drivers.survey import ReadWords
from gateway.commission.session import Site, make_target
from gateway.commission.session import site as site_module
from gateway.commission.session.evidence import FrameEvidence
from gateway.commission.survey import scan_units
from gateway.console import CommandResult


@dataclass
class AnsweringUnits:
    """A connection to units that answer by a rule: a word, or what is raised; what was asked is counted."""

    answers: Callable[[int], int | Exception]
    identity_raises: Exception = field(default_factory=lambda: DeviceException(1, "illegal function"))
    reads: list[int] = field(default_factory=list)
    identities: list[int] = field(default_factory=list)

    async def read(self, area: str, start: int, count: int, unit: int | None = None) -> ReadWords:
        assert unit is not None
        self.reads.append(unit)
        answer = self.answers(unit)
        if isinstance(answer, Exception):
            raise answer
        return ReadWords((answer,), 0.001)

    async def identity(self, unit: int | None = None) -> Mapping[str, str]:
        assert unit is not None
        self.identities.append(unit)
        raise self.identity_raises

    def statistics(self) -> Mapping[str, float]:
        return {}


@pytest.fixture
def scanned(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., tuple[CommandResult, Site]]:
    """Scan a line: the result, and the site with its notes."""

    def scan(line: AnsweringUnits, wanted: list[int] | None = None) -> tuple[CommandResult, Site]:
        @asynccontextmanager
        async def opened(*_: Any, **__: Any) -> AsyncIterator[AnsweringUnits]:
            yield line

        monkeypatch.setattr(site_module, "open_registers", opened)
        site = Site(make_target(given={"host": "127.0.0.1"}), FrameEvidence())
        return asyncio.run(scan_units(site, wanted, lambda *_: None)), site

    return scan


def silence(unit: int) -> Exception:
    return ReplyTimeout(f"unit {unit} is silent")


def test_after_twenty_silent_units_the_scan_ends_and_says_which_were_not_asked(scanned: Any) -> None:
    line = AnsweringUnits(lambda unit: 7 if unit in (1, 5) else silence(unit))
    result, site = scanned(line)
    assert [row["unit"] for row in result.data["units"]] == [1, 5]
    assert result.data["asked"] == 25 and max(unit for unit in line.reads if unit < 200) == 25
    assert any("20 silent units in a row: 26 to 247 were not asked" in note for note in site.notes)
    assert any("scan units 26-247" in note for note in site.notes)


def test_units_that_were_named_are_all_asked(scanned: Any) -> None:
    line = AnsweringUnits(lambda unit: 7 if unit == 100 else silence(unit))
    result, site = scanned(line, list(range(1, 101)))
    assert [row["unit"] for row in result.data["units"]] == [100] and result.data["asked"] == 100
    assert not any("were not asked" in note for note in site.notes)


def test_where_nobody_answers_the_scan_ends_too(scanned: Any) -> None:
    line = AnsweringUnits(silence)
    result, _ = scanned(line)
    assert result.code == 5 and len(line.reads) == 40


@pytest.mark.parametrize("trouble", [ReplyTimeout("silent"), LinkDown("closed", fault=LinkFault.CLOSED)])
def test_function_43_goes_to_no_other_unit_after_one_that_dislikes_it(scanned: Any, trouble: Exception) -> None:
    line = AnsweringUnits(lambda unit: 7 if unit < 6 else silence(unit), trouble)
    result, site = scanned(line)
    assert line.identities == [1] and len(result.data["units"]) == 5
    assert any("unit 1 took function 43" in note for note in site.notes)


def test_a_device_that_ignores_the_unit_number_is_called_one_and_asked_once_who_it_is(scanned: Any) -> None:
    line = AnsweringUnits(lambda unit: 7)
    result, site = scanned(line)
    assert result.data["ignores_unit"] and line.identities == [1]
    assert any("ignores the unit number" in note for note in site.notes)


def test_a_refusal_that_meets_any_number_is_no_unit(scanned: Any) -> None:
    refusal = DeviceException(4, "exception 4: server device failure")
    result, _ = scanned(AnsweringUnits(lambda unit: 7 if unit == 1 else refusal), list(range(1, 40)))
    assert [row["unit"] for row in result.data["units"]] == [1]
    assert not result.data["ignores_unit"]


def test_a_unit_that_hangs_up_is_silent_and_a_device_that_is_gone_ends_the_scan(scanned: Any) -> None:
    closed = LinkDown("closed", fault=LinkFault.CLOSED)
    result, _ = scanned(AnsweringUnits(lambda unit: 7 if unit in (1, 3) else closed), [1, 2, 3, 4])
    assert [row["unit"] for row in result.data["units"]] == [1, 3]
    with pytest.raises(LinkDown):
        scanned(AnsweringUnits(lambda unit: 7 if unit == 1 else LinkDown("refused", fault=LinkFault.REFUSED)), [1, 2])
