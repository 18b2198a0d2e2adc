"""Habits of real devices: each is read good, or named in one sentence with the setting that reads it."""

import asyncio
import random
import re
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.device_file import DeviceFile, TagTable
from drivers.errors import DeviceException, LinkDown, NotAsked, ReplyTimeout, WriteUnverified
from drivers.modbus import survey as survey_module
from drivers.modbus.driver import ModbusDriver, open_modbus
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.survey import open_survey
from drivers.modbus.wire import WireReply
from drivers.tag import Quality
from tests.rig.device_habits import HABITS, PAGE, PTY, DeviceHabit, page
from tests.rig.habit_wires import MOVING, TAGS, WALKED, Habit, Together, draw_habits, driven, served


async def values(driver: ModbusDriver, done: Callable[[list[int | None]], bool]) -> list[int | None]:
    """Readings, asked for until they are as wanted; none that is good may be another register's."""
    async with asyncio.timeout(30):
        while True:
            samples = await driver.read(TAGS)
            found = [
                int(sample.value) if sample.quality.is_good and sample.value is not None else None for sample in samples
            ]
            assert all(value in (number, None) for number, value in enumerate(found))
            if done(found):
                return found
            await asyncio.sleep(0.01)


@pytest.mark.parametrize(
    ("habit", "settings"),
    [
        (Habit(quiet=1.0), {}),
        (Habit(quiet=0.5), {"pause_after_connect": 0.6}),
        (Habit(transaction=0), {"transaction_id": "any"}),
        (Habit(transaction=77, unit=0), {"transaction_id": "any", "answers_as": 0}),
        (Habit(unit=255), {"answers_as": 255}),
        (Habit(beside=9), {}),
        (Habit(beside=9, late=0.05), {"timeout": 1.0}),
        (Habit(busy=2), {"timeout": 1.0}),
        (Habit(serial=True, lead=b"\0"), {}),
        (Habit(serial=True, lead=b"\0\xff\x55"), {}),
        (Habit(busy=1, transaction=0), {"transaction_id": "any", "timeout": 1.0}),
        (Habit(serial=True, lead=b"\0", busy=1), {"timeout": 1.0}),
        (Habit(quiet=0.4, busy=1), {"timeout": 1.0}),
    ],
    ids=str,
)
async def test_a_habit_is_read(habit: Habit, settings: dict[str, Any]) -> None:
    async with driven(habit, **settings) as driver:
        assert await values(driver, lambda found: None not in found) == list(range(8))


@pytest.mark.parametrize("habit", [Habit(unit=255, silent_at=5), Habit(unit=255, ends_connections=True)], ids=str)
@pytest.mark.parametrize("settings", [{}, {"outstanding": 2}], ids=["one at a time", "several"])
async def test_who_answers_as_another_unit_is_known_by_the_transaction_id_and_not_waited_for(
    habit: Habit, settings: dict[str, Any]
) -> None:
    lost = habit.silent_at >= 0
    async with driven(habit, answers_as=255, **settings) as driver:
        for _ in range(12):
            assert not any("not asked" in sample.reason for sample in await driver.read(TAGS))
        found = await values(driver, lambda found: found.count(None) == lost)
        assert not lost or found[5] is None


@pytest.mark.parametrize("settings", [{}, {"outstanding": 4}], ids=["one at a time", "several"])
async def test_a_late_answer_of_another_unit_is_no_later_questions(settings: dict[str, Any]) -> None:
    habit = Habit(unit=255, behind=3, moving=True)
    good = 0
    async with asyncio.timeout(300), driven(habit, answers_as=255, attempts=1, **settings) as driver:
        # One kept back is late however slow this machine is; the others are answered at once.
        while good < 60 or not driver.statistics()["timeouts"]:
            await asyncio.sleep(0.001)
            samples = await driver.read(TAGS)
            for number in MOVING:
                sent, value = samples[number].sent, samples[number].value
                if samples[number].quality.is_good and sent is not None and value is not None:
                    good += 1
                    assert habit.held(number, int(value), sent, samples[number].time)


@pytest.mark.parametrize("place", [0, 5, 7])
async def test_silence_at_one_register_costs_that_register(place: int) -> None:
    async with driven(Habit(silent_at=place)) as driver:
        found = await values(driver, lambda found: found.count(None) == 1)
        assert found[place] is None
        assert f"holding:{place}" in (await driver.read(TAGS))[place].reason


async def test_silence_at_one_register_of_a_line_costs_that_register_too() -> None:
    async with driven(Habit(serial=True, silent_at=5), longest_reply=0.2) as driver:
        found = await values(driver, lambda found: found.count(None) == 1)
        assert found[5] is None


@pytest.mark.parametrize("serial", [False, True], ids=["tcp", "line"])
@pytest.mark.parametrize(("even", "left_out"), [(True, ()), (False, (6,))], ids=["a block", "a tag by itself"])
async def test_silence_to_all_of_a_block_costs_that_block_alone(
    serial: bool, even: bool, left_out: tuple[int, ...]
) -> None:
    # With `even` a block of two is asked as a whole whichever of them is meant; without a neighbour a tag is a block.
    place, limits = (5, {"aligned": 2, "max_registers": 4, "max_write_registers": 8}) if even else (7, {"max_gap": 0})
    habit = Habit(serial=serial, silent_at=place, even=even)
    tags = [tag for number, tag in enumerate(TAGS) if number not in left_out]
    more = {"longest_reply": 0.2} if serial else {}
    async with asyncio.timeout(300), driven(habit, refused_first=600.0, refused_cap=600.0, **limits, **more) as driver:
        while not any(sample.quality is Quality.CONFIGURATION_ERROR for sample in await driver.read(tags)):
            pass
        asked = len(habit.requests)
        samples = await driver.read(tags)
        refused = {sample.tag for sample in samples if sample.quality is Quality.CONFIGURATION_ERROR}
        assert refused == ({"T4", "T5"} if even else {"T7"})
        assert all(sample.quality.is_good for sample in samples if sample.tag not in refused)
        assert all("no reply" in sample.reason for sample in samples if sample.tag in refused)
        assert not any(start <= place < start + count for _, start, count in habit.requests[asked:])


async def test_a_search_by_silence_takes_no_reading_longer_than_its_time() -> None:
    loop = asyncio.get_running_loop()
    async with driven(Habit(silent_at=5), timeout=0.3, attempts=1) as driver:
        while True:
            before, began = driver.statistics()["timeouts"], loop.time()
            samples = await driver.read(TAGS)
            # Two silent questions more than its time has room for: the one under way, and the one that found out.
            assert driver.statistics()["timeouts"] - before <= 3, f"{loop.time() - began:.2f} s"
            if sum(sample.quality.is_good for sample in samples) == 7:
                break


async def test_a_gateways_word_is_believed_by_hand_when_it_is_the_third() -> None:
    habit = Habit(no_way=2)
    async with served(habit) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        assert [raw.sample.value for raw in await survey.tags(TAGS)] == list(range(8))
    habit = Habit(no_way=100)
    async with served(habit) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        assert {raw.sample.quality for raw in await survey.tags(TAGS)} == {Quality.NO_COMMUNICATION}
    # A reading as the gateway has it, and its first question twice more.
    assert len(habit.requests) == 3


@pytest.mark.parametrize("refused", [False, True])
async def test_the_first_answer_is_timed_without_the_pauses_before_it(
    refused: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, pauses = 0.0, []

    async def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds
        pauses.append(seconds)

    async def answer(*_: object, **__: object) -> WireReply:
        nonlocal now
        now += 0.02
        if len(pauses) < 2 or refused:
            raise DeviceException((11, 10, 2)[len(pauses)], "refused")
        return WireReply((0,), now - 0.02, now)

    monkeypatch.setattr(survey_module, "asyncio", SimpleNamespace(sleep=sleep))
    monkeypatch.setattr(survey_module, "_now", lambda: now)
    async with served(Habit()) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        monkeypatch.setattr(survey.driver, "by_hand", answer)
        with pytest.raises(DeviceException, match="refused") if refused else nullcontext():
            await survey.read("holding", 0, 1)
        assert pauses == [0.1, 0.3]
        assert survey.statistics()["seconds_to_first"] == pytest.approx(0.02)


async def test_a_gateways_word_on_one_unit_among_several_is_the_answer() -> None:
    habit = Habit(no_way=100)
    async with served(habit) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        for unit in (1, 2):
            with pytest.raises(DeviceException, match="exception 11"):
                await survey.read("holding", 0, 1, unit)
            assert len(habit.requests) == unit


class LateAtFirst(Habit):
    def answer(self, pdu: bytes) -> bytes | None:
        self.late = 0.0 if self.requests else 1.2
        return super().answer(pdu)


async def test_a_first_answer_that_is_late_costs_no_tag_by_hand(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.modbus.survey.FIRST_ANSWER_S", 30.0)
    far = [TAGS[0], TAGS[7]]
    async with (
        served(LateAtFirst(), timeout=0.3, max_gap=0) as settings,
        open_survey(settings, clock=lambda: 0.0) as survey,
    ):
        assert [raw.sample.value for raw in await survey.tags(far)] == [0, 7]


async def test_silence_is_found_by_hand_too() -> None:
    async with served(Habit(silent_at=5)) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        raws = await survey.tags(TAGS)
        assert [raw.sample.value for raw in raws] == [0, 1, 2, 3, 4, None, 6, 7]
        # As the gateway has it: the place waits in quarantine.
        assert raws[5].sample.quality is Quality.CONFIGURATION_ERROR and "no reply" in raws[5].sample.reason


@pytest.mark.parametrize("serial", [False, True], ids=["tcp", "line"])
async def test_a_gateways_word_that_its_unit_is_silent_is_no_answer(serial: bool) -> None:
    habit = Habit(serial=serial)
    async with driven(habit, timeout=5.0) as driver:
        habit.no_way = 1
        assert len({sample.reason for sample in await driver.read(TAGS)} - {""}) == len(habit.requests) == 1
        await values(driver, lambda found: None not in found)
        habit.no_way = 1
        assert all(sample.quality.is_good for sample in await driver.read(TAGS))
        habit.no_way, asked = 100, len(habit.requests)
        for requests in (2, 3, 4):  # the first reading asks twice, and each one after it once
            samples = await driver.read(TAGS)
            assert all("exception 11" in sample.reason for sample in samples)
            assert len(habit.requests) == asked + requests
        habit.no_way = 0
        assert all(sample.quality.is_good for sample in await driver.read(TAGS))
        habit.no_way = 1
        assert all(sample.quality.is_good for sample in await driver.read(TAGS))


async def test_a_late_read_back_is_waited_for_within_the_writes_time() -> None:
    habit = Habit(stale=2)
    async with driven(habit, timeout=1.0) as driver:
        await values(driver, lambda found: None not in found)
        await driver.write([(TAGS[0], 100), (TAGS[1], 101)])
        assert driver.statistics()["late_read_backs"] >= 2
    assert habit.requests.count((16, 0, 2)) == 1 and (habit.registers[0], habit.registers[1]) == (100, 101)


async def test_a_write_refused_as_busy_is_sent_again_and_no_other_is() -> None:
    habit = Habit(busy=1)
    async with driven(habit, timeout=1.0) as driver:
        for _ in range(3):
            await driver.write([(TAGS[0], 9)])
        assert driver.statistics()["busy"] > 0
    habit = Habit()
    habit.answer = lambda pdu: bytes((pdu[0] | 0x80, 4)) if pdu[0] == 16 else Habit().answer(pdu)  # type: ignore[method-assign]
    async with driven(habit, timeout=1.0) as driver:
        with pytest.raises(DeviceException):
            await driver.write([(TAGS[0], 9)])


async def test_without_its_setting_the_habit_is_named() -> None:
    for habit, word in ((Habit(transaction=0), 'transaction_id = "any"'), (Habit(unit=0), "answers_as = 0")):
        async with driven(habit) as driver:
            sample = (await driver.read(TAGS))[0]
            assert not sample.quality.is_good and word in sample.reason


async def test_a_pseudo_terminal_is_opened_again_whatever_its_parity() -> None:
    async with served(Habit(serial=True), PTY, parity="E", timeout=1.0) as settings:
        for _ in range(2):
            driver = open_modbus(settings, clock=asyncio.get_running_loop().time)
            await driver.open()
            assert await values(driver, lambda found: None not in found) == list(range(8))
            await driver.close()


async def test_waiting_on_a_line_says_what_went_wrong_before() -> None:
    async with driven(Habit(serial=True, echo=True)) as driver:
        await driver.read(TAGS)
        sample = (await driver.read(TAGS))[0]
        assert "set echo = true" in sample.reason


@pytest.mark.parametrize("habit", [Habit(late=0.4), Habit(quiet=0.5)], ids=["slow", "quiet"])
async def test_the_first_question_by_hand_is_waited_for(habit: Habit) -> None:
    async with served(habit) as settings:
        del settings["timeout"]
        async with open_survey(settings, clock=asyncio.get_running_loop().time) as survey:
            words = await survey.read("holding", 3, 1)
            assert words.words == (3,)
            assert survey.statistics()["seconds_to_first"] >= max(habit.late, habit.quiet) / 2
            assert (await survey.read("holding", 4, 1)).words == (4,)


async def test_a_device_that_is_not_there_is_said_to_be_silent() -> None:
    async with served(Habit(quiet=1e9)) as settings, open_survey(settings, clock=lambda: 0.0) as survey:
        with pytest.raises(ReplyTimeout):
            await survey.read("holding", 0, 1)
        assert not survey.statistics()["foreign_replies"]


# ---------------------------------------------------------------- the table of habits


async def walk(together: Together, link: str, folder: Path) -> None:
    """A device with these habits is read, all but what it refuses, and takes a block; nothing wrong is good."""
    habit = together.device(link)
    lost = together.lost(habit)
    async with driven(habit, link, folder, **together.settings(link)) as driver:
        found = await values(driver, lambda found: found.count(None) == len(lost))
        assert {place for place, value in enumerate(found) if value is None} == lost
        async with asyncio.timeout(300):
            while True:
                try:
                    await driver.write([(TAGS[0], 100), (TAGS[1], 101)])
                    break
                except (LinkDown, NotAsked):
                    # It hung up, or an old answer is waited for: whether to write again is the caller's to decide.
                    await asyncio.sleep(0.01)
                except WriteUnverified as error:
                    # One that hangs up under a question whose answer would not say what it answers is waited for.
                    assert habit.ends_connections and "not asked" in str(error), link
                    break
        assert (habit.registers[0], habit.registers[1]) == (100, 101)


@pytest.mark.parametrize(
    ("row", "link"), [(row, link) for row in WALKED for link in row.over], ids=lambda of: getattr(of, "habit", of)
)
async def test_each_habit_is_read_alone(row: DeviceHabit, link: str, tmp_path: Path) -> None:
    await walk(Together((row,)), link, tmp_path)


async def test_drawn_habits_together_leave_every_other_register_readable(tmp_path: Path) -> None:
    rng = random.Random(39)
    drawn = [draw_habits(rng) for _ in range(60)]
    await asyncio.gather(*(walk(together, rng.choice(together.links), tmp_path) for together in drawn))


def test_the_page_of_habits_is_the_table() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "python -m tests.rig.device_habits"
    known = set(ModbusSettings.model_fields) | set(TagTable.model_fields) | set(DeviceFile.model_fields)
    for row in HABITS:
        named = re.findall(r"[a-z_]{4,}", re.sub(r'"[^"]*"', "", row.setting.replace("a list", "")))
        assert set(named) <= known and set(row.needs) <= known, row.habit
        path, _, name = row.test.partition("::")
        assert f"def {name}(" in (PAGE.parents[1] / path).read_text(encoding="utf-8"), row.habit
        assert all(re.fullmatch(r"[\w.-]+/[\w.-]+#\d+", thread) for thread in row.threads), row.habit
