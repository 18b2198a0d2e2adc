"""`decanter plc read`: tags or bare addresses, raw words and values, over any link or through the gateway."""

import asyncio
import struct
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import click
from click.core import ParameterSource

from drivers.codec import register_count
from drivers.driver import Explains, PlanKind
from drivers.survey import Raw
from drivers.tag import DType, Order, Quality, Tag
from gateway.commission.options import SharedOptions
from gateway.commission.session import Site, perform, read_samples, running_gateway
from gateway.commission.survey import SDO_S, AddressTextError, parse_stretch, reference_number
from gateway.console import CommandResult, Part, Rows
from gateway.entry import Exit

FIRST_WAIT_S = 3.0
_LOOK_S = 0.02
_LONGEST_NUMBER = 8
_WAITING = Quality.WAITING_FOR_INITIAL_DATA


@dataclass(frozen=True, slots=True)
class How:
    """How bare addresses are read: as `dtype` (None: as plain registers, shown in every way), and so on."""

    dtype: DType | None = None
    order: Order = Order.ABCD
    scale: float = 1.0
    offset: float = 0.0
    bit: int | None = None
    length: int = 0
    count: int = 1


def select_tags(site: Site, wanted: Sequence[str], how: How) -> list[Tag]:
    """The tags to read: names of the device file, or addresses, which are then their own names; none: all tags.

    Raises ValueError for what is neither.
    """
    known = {tag.name: tag for tag in site.target.tags}
    if not wanted:
        if not known:
            raise ValueError("what is to be read? Name addresses such as holding:100 or 40101, or give --device FILE")
        return list(known.values())
    dtype = how.dtype or DType.UINT16
    plain = Tag("", "", dtype, order=how.order, scale=how.scale, offset=how.offset, bit=how.bit, length=how.length)
    tags: list[Tag] = []
    for text in wanted:
        if text in known:
            tags.append(known[text])
        elif not site.target.capabilities.registers:
            tags.append(replace(plain, name=text, address=text))
        else:
            try:
                first, count = parse_stretch(text)
            except AddressTextError as error:
                others = f", and no tag of the device file, which has {', '.join(known)}" if known else ""
                raise ValueError(f"{error}{others}") from None
            places = [first.shift(step * register_count(plain)) for step in range(max(count, how.count))]
            kind = DType.BOOL if first.is_bit else dtype
            tags += [replace(plain, name=str(place), address=str(place), dtype=kind) for place in places]
    return tags


async def read_tags(site: Site, wanted: Sequence[str], how: How) -> CommandResult:
    """Read once. The exit code is that of the worst: nothing good at all by its kind, some bad a failed check."""
    tags = select_tags(site, wanted, how)
    raws = await read_raw(site, tags)
    plainly = how.dtype is None and how.bit is None
    if plainly and site.target.capabilities.nodes:
        # A bare object is the unsigned number that its bytes make, least first (CiA 301: little-endian); text
        # where they are too many for a number.
        for place, raw in enumerate(raws):
            if raw.raw and raw.tag not in site.target.tags:
                data = bytes(raw.raw)
                number = int.from_bytes(data, "little")
                value = number if len(data) <= _LONGEST_NUMBER else data.decode("latin-1").strip("\0 ")
                sample = replace(raw.sample, value=value, quality=Quality.GOOD, reason="")
                raws[place] = replace(raw, sample=sample)
    rows = []
    for raw in raws:
        sample, words = raw.sample, list(raw.raw) if raw.raw is not None else None
        digits = 4 if reference_number(raw.place) else 2  # a register's words, or bytes
        row: dict[str, Any] = {
            "tag": sample.tag,
            "address": raw.place,
            "reference": reference_number(raw.place),
            "raw": words,
            "hex": "" if words is None else " ".join(f"{word:0{digits}X}" for word in words),
            "value": sample.value,
            "unit": raw.tag.unit,
            "quality": sample.quality.name,
            "time": sample.time,
            "reason": sample.reason,
        }
        single = words is not None and len(words) == 1 and raw.tag.dtype is not DType.BOOL
        if words is not None and single and plainly and raw.tag not in site.target.tags:
            # Two's complement of the same bits.
            row["int16"] = struct.unpack(">h", struct.pack(">H", words[0]))[0]
            row["bits"] = f"{words[0]:016b}"
        rows.append(row)
    bad = [raw.sample for raw in raws if not raw.sample.quality.is_good]
    sentence = (
        f"{len(bad)} of {len(raws)} readings are not good, {bad[0].tag} the first: {bad[0].reason}" if bad else ""
    )
    # A device that is away explains a timeout beside it, and a timeout a refusal: the first in this order is the code.
    qualities = {raw.sample.quality for raw in raws}
    code = Exit.CHECK_FAILED
    if any(quality.is_good for quality in qualities):
        pass
    elif qualities & {Quality.NOT_CONNECTED, Quality.COMMUNICATION_ERROR, Quality.NO_COMMUNICATION}:
        code = Exit.CANNOT_CONNECT
    elif Quality.TIMEOUT in qualities:
        code = Exit.TIMEOUT
    elif qualities & {Quality.CONFIGURATION_ERROR, Quality.DEVICE_FAILURE, Quality.NO_DATA}:
        code = Exit.DEVICE_EXCEPTION
    return CommandResult({"readings": rows}, sentence, code)


async def read_raw(site: Site, tags: Sequence[Tag]) -> list[Raw]:
    """The tags with their raw words where the link shows them: through the running gateway, or of the device."""
    line = running_gateway(site.target)
    if line is not None:
        with closing(line):
            reply, samples = await asyncio.to_thread(read_samples, line, tags, site.target.tags)
        site.notes.append(f"read through the running gateway (pid {reply['pid']}), which shows values and no raw words")
        by_name = {tag.name: tag for tag in tags}
        return [Raw(by_name[sample.tag], sample, by_name[sample.tag].address, 1) for sample in samples]
    settings = site.target.settings
    if site.target.capabilities.nodes:
        # The node's objects as they stand, whatever its state; the gateway takes them from PDOs where it can.
        site.notes.append(
            "asked by SDO; the gateway itself takes what TPDOs carry from those (decanter plc read --watch)"
        )
        async with site.bus() as bus:
            return await bus.tags(tags, int(settings.get("node", 1)), float(settings.get("timeout", SDO_S)))
    if site.target.capabilities.registers:
        async with site.registers() as survey:
            return await survey.tags(tags)
    async with site.driver() as driver:
        # What speaks by itself may not have done so yet: it is waited for, at most FIRST_WAIT_S.
        samples = await driver.read(tags)
        until = time.monotonic() + FIRST_WAIT_S
        while any(sample.quality is _WAITING for sample in samples) and time.monotonic() < until:
            await asyncio.sleep(_LOOK_S)
            samples = await driver.read(tags)
        if isinstance(driver, Explains):
            site.notes.extend(line for line in driver.explain(tags) if line.kind is PlanKind.HEARD)
    return [Raw(tag, sample, tag.address, 1) for tag, sample in zip(tags, samples, strict=True)]


def read(
    given: SharedOptions,
    what: Sequence[str],
    dtype: str | None,
    order: str,
    scale: float,
    offset: float,
    bit: int | None,
    length: int,
    count: int,
    watches: bool,
    period: float,
    seconds: float | None,
) -> None:
    """The work of `plc read`."""
    kind = DType(dtype) if dtype else None
    how = How(
        dtype=kind,
        order=Order(order),
        scale=scale,
        offset=offset,
        bit=bit,
        length=length if kind is DType.STRING else 0,
        count=count,
    )
    if watches:
        from gateway.commission.watch import watch  # it reads by what stands here

        watch(given, what, how, period, seconds)
        return
    source = click.get_current_context().get_parameter_source
    if any(source(name) is not ParameterSource.DEFAULT for name in ("period", "seconds")):
        raise click.UsageError("--period and --seconds belong to --watch")
    arguments = {"what": list(what), "type": dtype, "order": order, "scale": scale, "offset": offset, "count": count}
    perform(given, "read", arguments, lambda site: read_tags(site, what, how), _view)


def _view(data: Mapping[str, Any]) -> Iterator[Part]:
    """The readings as a table; columns that say nothing are left out."""
    rows = data["readings"]
    keys = ["tag", "address", "reference", "hex", "value", "unit", "int16", "bits", "quality", "reason"]
    if all(row["tag"] == row["address"] for row in rows):
        keys.remove("tag")
    keys = [key for key in keys if any(row.get(key) not in (None, "") for row in rows)]
    good = sum(row["quality"] == "GOOD" for row in rows)
    cells = [{key: shown_value(cell) for key, cell in row.items()} for row in rows]
    yield Rows(f"{good} of {len(rows)} good", keys, cells)


def shown_value(cell: Any) -> Any:
    """A flag is on or off; a whole number is shown whole."""
    if isinstance(cell, bool):
        return "on" if cell else "off"
    return f"{cell:.7g}" if isinstance(cell, float) else cell
