"""A PLC was loaded anew while the gateway ran, and its floats came with swapped words: no bench could show that."""

from collections.abc import Iterator

import pytest

from drivers.codec import decode
from drivers.tag import Quality, Sample
from gateway.machine.reading.quality import DEAD_PERIODS, DeviceAge, QualityRules, judge
from gateway.settings import load_device
from sim.plc.program.faults import FAULTS, face_shows, merge_effects
from sim.plc.program.image import ProcessImage
from sim.plc.program.registers import read_map
from tests.plc.bench import DECANTER, Process, running

HEAT, OTHER = "TCuscinettiRiduttore", "TCuscinettiAlimentazione"
TAGS = {tag.name: tag for tag in load_device(DECANTER).tags}


def readings(image: ProcessImage, name: str) -> Sample:
    """What a driver makes of the tag's registers as they stand."""
    place = image.registers.places[name]
    value, quality, reason = decode(TAGS[name], image.read(place.table, place.address, place.words))
    return Sample(name, value, quality, 0.0, sent=0.0, reason=reason)


def test_the_words_of_numbers_are_turned_and_turned_back_and_nothing_else_is() -> None:
    image = ProcessImage(read_map(DECANTER))
    values = {HEAT: 40.8, OTHER: 52.3, "Assorbimento": 120.0, "MarciaDecanter": True}
    image.learn(values)
    image.serve()
    assert readings(image, HEAT).value == pytest.approx(40.8)
    # With the value as it was: the flip alone changes the registers.
    image.serve(swapped=lambda name: name == HEAT)
    assert readings(image, HEAT).quality is Quality.DATA_ENCODING_INVALID
    assert "as ABCD it reads 40.8" in readings(image, HEAT).reason
    assert readings(image, OTHER).value == pytest.approx(52.3)
    image.serve(swapped=lambda _: True)
    assert readings(image, OTHER).quality is Quality.DATA_ENCODING_INVALID
    assert readings(image, "Assorbimento").value == pytest.approx(120.0)
    image.serve(frozen=lambda _: True)
    assert readings(image, HEAT).quality is Quality.DATA_ENCODING_INVALID, "what is frozen stays as it is"
    image.clear()
    image.serve()
    assert (readings(image, HEAT).quality, readings(image, OTHER).quality) == (Quality.GOOD, Quality.GOOD)


def test_after_the_first_one_no_value_is_good_until_they_have_been_right_for_a_while() -> None:
    """Values whose swapped words are numbers like any other come now and then; nothing else tells them."""
    image, tag = ProcessImage(read_map(DECANTER)), TAGS[HEAT]
    age, rules, states = DeviceAge(), QualityRules(1.0), list[tuple[bool, Quality]]()
    for second in range(200):
        flipped = 20 <= second < 150
        image.learn({HEAT: 20.0 + 0.37 * second})
        image.serve(swapped=lambda _, now=flipped: now)  # type: ignore[misc]
        seen = Sample(**{**_fields(readings(image, HEAT)), "time": float(second), "sent": float(second)})
        age, judged = judge(age, [tag], [seen], float(second), rules)
        states.append((flipped, judged[HEAT].quality))
    first = next(number for number, (_, quality) in enumerate(states) if quality is Quality.DATA_ENCODING_INVALID)
    assert 20 <= first < 25
    assert not any(quality.is_good for flipped, quality in states[first:] if flipped)
    back = next(number for number, (_, quality) in enumerate(states) if number > 150 and quality.is_good)
    assert back <= 150 + DEAD_PERIODS + 1


def _fields(sample: Sample) -> dict[str, object]:
    return {name: getattr(sample, name) for name in ("tag", "value", "quality", "reason")}


@pytest.fixture(scope="module")
def plain() -> Iterator[Process]:
    with running() as process:
        yield process


def test_the_fault_is_ordered_by_name_of_tags_that_are_there_and_of_no_single_face(plain: Process) -> None:
    assert face_shows("swapped_words", "serial") and not face_shows("swapped_words", "canopen")
    both = merge_effects([FAULTS["swapped_words"](0.0, tags=[HEAT]), FAULTS["swapped_words"](0.0, tags=[OTHER])])
    assert both.swapped == {HEAT, OTHER}
    plain.fault("swapped_words", tags=[HEAT], duration=0.1)
    for parameters, reason in (({"tags": ["Nothing"]}, "Nothing"), ({"face": "tcp"}, "behind all faces")):
        with pytest.raises(AssertionError, match=reason):
            plain.fault("swapped_words", **parameters)
