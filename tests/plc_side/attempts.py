"""Attempts to write where nothing may be written, drawn at random: tags, values, configurations, requests, commands."""

import math
from collections.abc import Iterator
from dataclasses import replace
from random import Random
from typing import Any

from drivers.tag import DType, Order, Tag, Value
from gateway.settings.devices import DeviceMap

Attempt = list[tuple[Tag, Value]]
UNFIT: tuple[Any, ...] = (70_000, -1, math.nan, math.inf, 1e300, "text", 0.5j, None)


def elsewhere(random: Random, driver: str) -> str:
    """An address in the driver's notation that is no word of the shipped block (holding:400 to 425 or 0x2100)."""
    if driver == "modbus":
        table = random.choice(("holding", "holding", "coil", "input", "discrete"))
        low, high = random.choice(((0, 399), (426, 65_535)))
        return f"{table}:{random.randint(low, high)}"
    if driver == "canopen":
        index = random.choice((0x1005, 0x1010, 0x1017, 0x1400, 0x1A00, 0x2000, 0x2001, 0x2101, 0x2102, 0x6000))
        return f"0x{index:04X}:{random.randint(0, 40)}"
    place = random.choice(("States", "Service", "PlcStatus", "WritebackEcho"))
    number = random.choice((0x001, 0x100, 0x181, 0x301, 0x7FF))
    return random.choice((f"dbc:{place}.{random.choice(('sequence', 'WritePermit'))}", f"0x{number:X}:{8}|16@1"))


def strange_tag(random: Random, device: DeviceMap) -> Tag:
    """A tag that is not in the write map, however much it looks like one that is."""
    assert device.writeback is not None
    word = random.choice(device.writeback.words)
    kind = random.choice([kind for kind in DType if kind is not DType.UINT16])
    return random.choice(
        (
            random.choice(device.tags),
            replace(random.choice(device.tags), writable=True),
            replace(word, address=elsewhere(random, device.driver)),
            replace(word, dtype=kind, length=random.randint(1, 40) if kind is DType.STRING else 0),
            replace(word, bit=random.randrange(16)),
            replace(word, order=random.choice((Order.CDAB, Order.BADC, Order.DCBA))),
            replace(word, scale=random.choice((0.1, 10.0, -1.0)), offset=random.uniform(1, 9)),
            replace(word, name=random.choice(device.tags).name),
            replace(word, name=word.name + " "),
            Tag("Writeback.free", elsewhere(random, device.driver), writable=True),
        )
    )


def attempt(random: Random, device: DeviceMap) -> Attempt:
    """Values for tags, at least one of which must keep all of them from the wire."""
    assert device.writeback is not None
    words = list(device.writeback.words)
    good: Attempt = [(word, random.randrange(0x10000)) for word in words]
    if random.random() < 0.2:
        place = random.randrange(len(good))
        good[place] = (good[place][0], random.choice(UNFIT))
        return good
    strange = (strange_tag(random, device), random.choice((0, 1, 40_000, 1.5, True)))
    how = random.randrange(4)
    if how == 0:
        return [strange]
    if how == 1:
        return [*good, strange]
    if how == 2:
        return [strange, *good]
    place = random.randrange(len(good))
    return [*good[:place], strange, *good[place + 1 :]]


def configurations(random: Random, count: int) -> Iterator[dict[str, Any]]:
    """Overrides of a plant file that would let something be written without a signed arming, or more than the block."""
    for _ in range(count):
        signed: dict[str, Any] = {"writeback.armed_by": "Ada", "writeback.reason": "test", "writeback.minutes": 5.0}
        trick: dict[str, Any] = random.choice(
            (
                {"writeback.armed_by": ""},
                {"writeback.reason": ""},
                {"writeback.minutes": random.choice((0.0, -5.0, 481.0, 1e9, math.inf, math.nan, "5", None))},
                {"writeback.address": f"holding:{random.randint(0, 65_535)}"},
                {"writeback.write_map": ["holding:100"]},
                {"writeback.most_per_second": random.choice((0.0, -1.0, math.inf, 1e9))},
                {"device.write_map": ["holding:100"]},
                {"device.writable": True},
                {"scan.write": True},
                {"model.write": "holding:100"},
                {"write": {"holding:100": 1}},
            )
        )
        yield {"writeback.mode": "armed", **signed, **trick}


def requests(random: Random, count: int) -> Iterator[dict[str, Any]]:
    """Requests to the gateway's control socket that must not lead to a write."""
    verbs = ("write", "set", "force", "write_registers", "put", "send", "Arm", "armed", "exec", "")
    for _ in range(count):
        address = f"holding:{random.randint(0, 500)}"
        yield random.choice(
            (
                {"command": random.choice(verbs), "address": address, "value": random.randrange(0x10000)},
                {"command": "read", "tags": ["TFango"], "write": {address: 1}},
                {"command": "read", "addresses": [{"address": address, "writable": True}]},
                {"command": "read", "addresses": [{"address": address, "value": 5}]},
                {"command": "arm", "by": random.choice(("", " ", 5, None)), "reason": "x", "minutes": 5},
                {"command": "arm", "by": "Ada", "reason": random.choice(("", "\n", 5)), "minutes": 5},
                {"command": "arm", "by": "Ada", "reason": "x", "minutes": random.choice((0, -1, 481, 1e12, "5", True))},
                {"command": "status", "writeback": "armed"},
                {"command": ["arm"], "by": "Ada", "reason": "x", "minutes": 5},
            )
        )


def commands(random: Random, count: int, place: list[str], device: str) -> Iterator[list[str]]:
    """Command lines that must not lead to a write: none of them is armed, and there is no command that writes a tag."""
    for _ in range(count):
        address = f"holding:{random.randint(0, 500)}"
        known = ["--device", device, *place]
        yield random.choice(
            (
                ["plc", "check", "write", "alarms", *known],
                ["plc", "check", "write", "heartbeat", *known],
                ["plc", "check", "write", "conformance", *known],
                ["disarm", *known],
                ["arm", "--reason", "x", "--minutes", random.choice(("0", "-3", "481", "nan", "inf")), *known],
                ["arm", "--reason", "", "--minutes", "5", *known],
                ["plc", "write", address, "5", *known],
                ["plc", "loop", "alarms", *known],
                ["plc", "check", "plan", "--write", "--value", "5", *known],
                ["plc", "read", f"{address}=5", *known],
                ["plc", "read", "TFango", "--set", "write_map=[1]", *known],
                ["plc", "check", "write", "alarms", "--audit", "none.sqlite", *known],
                ["run", "--write", address],
            )
        )
