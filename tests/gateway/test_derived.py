"""Signals that a device does not have and that are made of its tags, by the law of the column maps."""

import asyncio
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.derived import Derived, with_derived
from drivers.settings import ConfigError
from drivers.tag import DType, Quality, Sample, Tag
from gateway.machine.reading.quality import QualityRules
from gateway.machine.reading.scan import scans
from gateway.settings import load_device
from tests.gateway.support import JumpClock
from tests.gateway.test_scan import Slow

DEVICE = """
[device]
name = "plc"
driver = "modbus"
[[tags]]
name = "Current"
address = "holding:1"
[[tags]]
name = "Voltage"
address = "holding:2"
[[tags]]
name = "Serial"
address = "holding:3"
dtype = "string"
length = 8
"""
RUNNING, POWER = Derived(signal="Current", above=0.3), Derived(product=("Current", "Voltage"), scale=0.001, unit="kW")


def told(**changes: object) -> dict[str, Sample]:
    """Current and voltage of one moment; `changes` are of the current's sample."""
    current = Sample("Current", 120.0, Quality.GOOD, 10.0, sent=9.9)
    return {"Current": replace(current, **changes), "Voltage": Sample("Voltage", 400, Quality.GOOD, 9.5, sent=9.4)}


def test_a_derived_signal_is_worth_what_the_worst_of_its_sources_is_and_no_younger() -> None:
    found = with_derived(told(), {"Running": RUNNING, "Power": POWER, "One": Derived(constant=1.0)}, 11.0)
    assert found["Running"] == Sample("Running", True, Quality.GOOD, 10.0, sent=9.9)
    assert found["Power"] == Sample("Power", 48.0, Quality.GOOD, 9.5, sent=9.4)
    assert found["One"] == Sample("One", 1.0, Quality.GOOD, 11.0)
    doubted = with_derived(told(quality=Quality.LAST_USABLE, reason="4 s old"), {"Power": POWER}, 11.0)["Power"]
    assert (doubted.value, doubted.quality, doubted.reason) == (48.0, Quality.LAST_USABLE, "Current: 4 s old")
    gone = with_derived(told(value=None, quality=Quality.TIMEOUT, reason="no reply"), {"Running": RUNNING}, 11.0)
    assert (gone["Running"].value, gone["Running"].quality) == (None, Quality.TIMEOUT)


def test_a_product_beyond_any_number_has_no_value() -> None:
    found = with_derived(told(value=1e308), {"Power": Derived(product=("Current", "Voltage"))}, 11.0)["Power"]
    assert (found.value, found.quality) == (None, Quality.DECODING_ERROR) and "beyond any number" in found.reason


@pytest.mark.parametrize("law", [RUNNING, Derived(signal="Current", below=0.5), Derived(signal="Current", above=-1.0)])
def test_a_number_and_an_array_are_judged_alike(law: Derived) -> None:
    values = np.array([-2.0, -1.0, 0.0, 0.3, 0.31, 0.5, 7.0])
    assert law.value([values]).tolist() == [law.value([value]) for value in values.tolist()]


def test_a_device_file_has_them_beside_its_tags_and_asks_the_device_for_tags_alone(tmp_path: Path) -> None:
    path = tmp_path / "plc.toml"
    path.write_text(DEVICE + '[derived]\nRunning = { signal = "Current", above = 0.3 }\n', encoding="utf-8")
    device = load_device(path)
    assert [tag.name for tag in device.tags] == ["Current", "Voltage", "Serial"]
    assert device.by_name["Running"] == Tag("Running", "", DType.BOOL)
    asked: list[str] = []

    class Asked(Slow):
        async def read(self, tags: Sequence[Tag]) -> list[Sample]:
            asked.extend(tag.name for tag in tags)
            return await super().read(tags)

    async def first() -> dict[str, Sample]:
        stop = asyncio.Event()
        clock = JumpClock()
        stream = scans(Asked(clock), device.tags, clock, QualityRules(1.0), derived=device.derived, stop=stop)
        scan = await anext(stream)
        await stream.aclose()
        return dict(scan.samples)

    samples = asyncio.run(first())
    assert asked == ["Current", "Voltage", "Serial"] and samples["Running"].value is True


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('Running = { signal = "Curent", above = 0.3 }', "derived.Running: needs 'Curent', which is no tag"),
        (
            'Running = { signal = "Serial", above = 0.3 }',
            "derived.Running: needs 'Serial', which is no tag of this file",
        ),
        ('Voltage = { signal = "Current", above = 0.3 }', "derived.Voltage: is the name of a tag already"),
        ('Running = { signal = "Current" }', "give either signal and above"),
        ('Running = { signal = "Current", abov = 1 }', "derived.Running.abov"),
        ('Running = { product = ["Current"] }', "product needs two signals"),
    ],
)
def test_what_cannot_be_made_is_one_sentence(text: str, words: str, tmp_path: Path) -> None:
    path = tmp_path / "plc.toml"
    path.write_text(f"{DEVICE}[derived]\n{text}\n", encoding="utf-8")
    with pytest.raises(ConfigError) as error:
        load_device(path)
    assert words in str(error.value) and str(path) in str(error.value) and len(error.value.problems) == 1
