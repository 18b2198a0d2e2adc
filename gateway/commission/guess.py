"""`decanter plc guess`: the registers around an address and what the HMI shows, with the readings given before."""

import asyncio
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click

from drivers.errors import DeviceException, LinkDown
from drivers.survey import AsksRegisters
from drivers.tag import DType, Tag
from gateway.commission.encodings import Observation, ShownNumber, advise, parse_display, rank
from gateway.commission.options import SharedOptions
from gateway.commission.session import (
    Site,
    find_target,
    perform,
    read_records,
    read_samples,
    running_gateway,
)
from gateway.commission.survey import LAST_ADDRESS, Register, parse_register
from gateway.console import CommandResult, Part, Rows
from gateway.entry import sentences

REGISTERS_BEFORE, REGISTERS_AFTER = 2, 5
"""Registers read besides the one that was given: twice off by one, and a value of four registers."""
READING_MEMORY_S = 4 * 3600.0
"""Earlier readings of the same address are taken into account for so long."""
SHOWN_ROWS = 8


@dataclass(frozen=True, slots=True)
class Flag:
    """Registers of one moment, and the state that the HMI showed then."""

    base: int
    words: tuple[int, ...]
    state: bool


async def guess_encoding(site: Site, register: Register, text: str, earlier: Sequence[dict[str, Any]]) -> CommandResult:
    """Rank the encodings by this reading and the `earlier` ones (as the records have them), and say what is left.

    Raises ReadingError for a text that is no reading; DriverError where the registers cannot be read.
    """
    shown = parse_display(text)
    base, words = await _neighbour_words(site, register)
    now = {"base": base, "words": words, "reading": text}
    readings = [*earlier, now]
    if isinstance(shown, bool):
        return _states(register, readings, now)
    observations = [
        Observation(reading["base"], tuple(reading["words"]), number)
        for reading in readings
        if isinstance(number := parse_display(reading["reading"]), ShownNumber)
    ]
    candidates = rank(observations, register.number)
    advice = advise(candidates, observations)
    rows = []
    for candidate in candidates[:SHOWN_ROWS]:
        place = Register(register.table, candidate.address)
        row = asdict(candidate) | {"dtype": candidate.dtype.value, "order": candidate.order.value}
        row |= {"values": list(candidate.values), "address": str(place), "reference": place.reference}
        rows.append(row | {"shift": candidate.address - register.number})
    data: dict[str, Any] = {
        "address": str(register),
        "reading": text,
        "observation": now,
        "readings": len(observations),
        "candidates": rows,
        "settled": advice.is_settled and bool(candidates),
        "advice": list(advice.sentences),
        "second_reading": {"below": advice.below, "above": advice.above},
    }
    complaint = (
        f"nothing at or beside {register} explains {len(observations)} readings: is it the right register and "
        "unit, did the value move while it was read? --fresh forgets earlier readings"
    )
    return CommandResult(data, "" if candidates else complaint)


async def _neighbour_words(site: Site, register: Register) -> tuple[int, list[int]]:
    """The registers around one: by the running gateway's connection where one runs, else by one of our own."""
    line = running_gateway(site.target)
    if line is None:
        async with site.registers() as survey:
            return await read_neighbours(survey, register)
    places = [Register(register.table, number) for number in range(*_window(register))]
    tags = [Tag(str(place), str(place), DType.BOOL if register.is_bit else DType.UINT16) for place in places]
    with closing(line):
        _, samples = await asyncio.to_thread(read_samples, line, tags, ())
    site.notes.append("read through the running gateway")
    known = {parse_register(sample.tag).number: int(sample.value or 0) for sample in samples if sample.quality.is_good}
    if not known:
        raise LinkDown(f"the running gateway cannot read around {register}: {samples[0].reason}")
    low, high = _stretch(known, register.number)
    return low, [known[number] for number in range(low, high + 1)]


def _window(register: Register) -> tuple[int, int]:
    """The first register to be read, and the one after the last."""
    return max(0, register.number - REGISTERS_BEFORE), min(LAST_ADDRESS, register.number + REGISTERS_AFTER) + 1


def _stretch(known: Mapping[int, int], number: int) -> tuple[int, int]:
    """The first and the last of the known addresses that follow one another nearest to the given one."""
    low = high = min(known, key=lambda other: abs(other - number))
    while low - 1 in known:
        low -= 1
    while high + 1 in known:
        high += 1
    return low, high


async def read_neighbours(survey: AsksRegisters, register: Register) -> tuple[int, list[int]]:
    """The registers around one: the first one's number, and the words, of one moment where the device allows it.

    Where a neighbour is refused they are asked one by one, and those that follow one another nearest to the address are
    taken. Raises DriverError.
    """
    first, end = _window(register)
    try:
        return first, list((await survey.read(register.table, first, end - first)).words)
    except DeviceException as error:
        refusal = error
    single: dict[int, int] = {}
    for number in range(first, end):
        with suppress(DeviceException):
            single[number] = (await survey.read(register.table, number, 1)).words[0]
    if not single:
        raise refusal
    low, high = _stretch(single, register.number)
    # Now that the stretch is known it is asked at once: words of one moment are worth more than words of several.
    with suppress(DeviceException):
        return low, list((await survey.read(register.table, low, high - low + 1)).words)
    return low, [single[number] for number in range(low, high + 1)]


def earlier_readings(path: Path, place: str, register: Register, now: float) -> list[dict[str, Any]]:
    """What was read of the same register of the same device before, from the records; [] without any.

    Raises RecordsError.
    """
    if not path.is_file():
        return []
    return [
        dict(record.result["observation"])
        for record in read_records(path)
        if record.command == "guess"
        and record.place == place
        and record.result.get("address") == str(register)
        and "observation" in record.result
        and now - record.time <= READING_MEMORY_S
    ]


def _states(register: Register, readings: Sequence[dict[str, Any]], now: dict[str, Any]) -> CommandResult:
    """The bits at and beside the address that were as the HMI showed them every time."""
    flags = [
        Flag(reading["base"], tuple(reading["words"]), state)
        for reading in readings
        if isinstance(state := parse_display(reading["reading"]), bool)
    ]
    bits: list[dict[str, Any]] = []
    # Lists count registers from 0 or from 1, so that the neighbours are as likely; the given one comes first.
    for shift in (0, -1, 1):
        number = register.number + shift
        for bit in [0] if register.is_bit else range(16):
            if all(
                0 <= number - flag.base < len(flag.words)
                and bool(flag.words[number - flag.base] >> bit & 1) == flag.state
                for flag in flags
            ):
                bits.append({"address": str(Register(register.table, number)), "bit": bit, "shift": shift})
    # A bit that never moves agrees by chance: only one that was seen in both states is told from it.
    both = len({flag.state for flag in flags}) == 2
    at_address = [bit for bit in bits if bit["shift"] == 0]
    settled = both and (len(at_address) == 1 or len(bits) == 1)
    advice = [] if settled else [f"{len(bits)} bits agree: read again in {'either' if both else 'the other'} state"]
    data = {
        "address": str(register),
        "reading": now["reading"],
        "observation": now,
        "readings": len(flags),
        "bits": bits,
        "settled": settled,
        "advice": advice,
    }
    return CommandResult(data, "" if bits else f"no bit at or beside {register} agrees")


def guess(given: SharedOptions, address: str, reading: str | None, fresh: bool) -> None:
    """Carry out `decanter plc guess`; its options and its help are in commission/commands.py."""
    with sentences():
        register = parse_register(address)
        target = find_target(given)
        own = target.capabilities
        if not own.registers:
            raise ValueError(
                f"link {target.kind!r}: types and orders stand in {own.described_in}; guess is for registers"
            )
        earlier = [] if fresh else earlier_readings(given.records, target.place, register, time.time())
        # Asked for last, when nothing that was given can be refused any more.
        if reading is None and not sys.stdin.isatty():
            raise ValueError("what does the HMI show? Give it as the second argument, such as: guess holding:100 72.4")
        shown = reading if reading is not None else str(click.prompt("The HMI shows"))
    arguments = {"address": str(register), "reading": shown, "earlier": len(earlier)}
    work = partial(guess_encoding, register=register, text=shown, earlier=earlier)
    perform(given, "guess", arguments, work, _view, target=target)


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    words = " ".join(f"{word:04X}" for word in data["observation"]["words"])
    yield f"registers from {data['observation']['base']}: {words}"
    if "bits" in data:
        places: dict[str, list[str]] = {}
        for bit in data["bits"]:
            places.setdefault(bit["address"], []).append(str(bit["bit"]))
        agreeing = [(place, " ".join(bits)) for place, bits in places.items()]
        yield Rows(f"{data['readings']} readings, {len(data['bits'])} bits agree", ("address", "bits"), agreeing)
    else:
        columns = ("belief", "address", "reference", "type", "order", "scale", "offset", "it reads")
        rows = []
        for candidate in data["candidates"]:
            moved = f" ({candidate['shift']:+d})" if candidate["shift"] else ""
            kind = (candidate["reference"], candidate["dtype"], candidate["order"])
            numbers = (f"{candidate['scale']:.6g}", f"{candidate['offset']:g}")
            reads = " ".join(f"{value:.6g}" for value in candidate["values"])
            rows.append((f"{candidate['share']:.1%}", f"{candidate['address']}{moved}", *kind, *numbers, reads))
        yield Rows(f"{data['readings']} readings", columns, rows)
    yield from data["advice"]
