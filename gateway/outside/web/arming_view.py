"""What somebody should know before a machine is armed: where it is, what would be written there, what was refused."""

from collections.abc import Mapping
from typing import Any

from gateway.outside.status import GatewayStatus, TemperatureStatus
from gateway.outside.texts import Words
from sim.units import display_unit

MODES = ("off", "shadow", "armed")
"""The modes of writing, the least first."""


def machine_mode(status: GatewayStatus) -> str:
    """The mode of a machine: that of the block which is written the most."""
    return max((str(one.writeback["mode"]) for one in _predictions(status)), key=MODES.index)


def _predictions(status: GatewayStatus) -> tuple[GatewayStatus | TemperatureStatus, ...]:
    return (status, *status.further)


def arming_view(words: Words, labels: Mapping[str, str], status: GatewayStatus) -> dict[str, Any] | None:
    """The machine's address and identity, and its blocks with what the PLC would read; None where nothing is written.

    A block has the `label` of its temperature, its `address` and `words`, its numbers as rows of a name and a text, and
    what was refused of it last.
    """
    blocks = [(one, one.writeback) for one in _predictions(status) if one.writeback["mode"] != "off"]
    if not blocks:
        return None
    unknown, challenge = words.say("word.unknown"), status.values.get("Challenge")
    numbers = {
        "challenge": unknown if challenge is None or challenge.value is None else challenge.value,
        "writer": blocks[0][1].get("writer") or unknown,
    }
    return {
        "address": status.place,
        "identity": words.say("arming.identity_is", **numbers),
        "blocks": [
            {
                "label": labels.get(one.temperature, one.temperature),
                "address": w.get("block", {}).get("address", ""),
                "words": w.get("block", {}).get("words", 0),
                "numbers": _numbers(words, w.get("block", {}).get("numbers", {}), display_unit(one.unit)),
                "refusals": _refusals(words, w),
            }
            for one, w in blocks
        ],
    }


def _numbers(words: Words, numbers: Mapping[str, float | None], unit: str) -> list[tuple[str, str]]:
    """The numbers of a block that a PLC would act on, as they are read out of its words."""

    def format_numbers(names: tuple[str, ...], digits: int, times: float) -> str:
        texts = [
            missing_text(name) if (n := numbers[name]) is None else words.number(times * n, digits) for name in names
        ]
        return " – ".join(dict.fromkeys(texts))

    def missing_text(name: str) -> str:
        return words.say("sentence.beyond", minutes=minutes) if "minutes" in name else words.say("word.unknown")

    horizon = numbers.get("horizon")
    minutes = words.say("word.unknown") if horizon is None else words.minutes(horizon)
    ahead = words.say("word.in_minutes", minutes=minutes)
    rows: tuple[tuple[str, tuple[str, ...], str, int, float], ...] = (
        (words.say("word.predicted"), ("temperature_now",), f" {unit}", 1, 1.0),
        (words.say("word.band"), ("band_low", "band_high"), f" {unit}", 1, 1.0),
        (f"{words.say('word.median')} {ahead}", ("horizon_median",), f" {unit}", 1, 1.0),
        (f"{words.say('word.p_limit')} {ahead}", ("p_limit",), " %", 0, 100.0),
        (words.say("word.minutes_to_limit"), ("minutes_median",), "", 0, 1.0),
        (words.say("arming.band_of_minutes"), ("minutes_low", "minutes_high"), "", 0, 1.0),
    )
    return [
        (label, format_numbers(names, digits, times) + of)
        for label, names, of, digits, times in rows
        if all(name in numbers for name in names)
    ]


def _refusals(words: Words, w: Mapping[str, Any]) -> str:
    """What the PLC refused last, and why the newest block was not written."""
    found = []
    if w.get("last_refusal"):
        found.append(
            words.say("arming.refused", reason=words.of_code(f"refusal.{w['last_refusal']}"), count=w.get("refused", 0))
        )
    if w.get("last_verdict") not in (None, "written", "shadow"):
        found.append(
            words.of_code(f"verdict.{w['last_verdict']}") + f": {w.get('last_reason') or words.say('word.unknown')}"
        )
    return "; ".join(found) or words.say("word.none")
