"""How a Modbus device would be read, request by request, before anything is sent (see `drivers.survey`)."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from drivers.errors import AddressError
from drivers.modbus import rtu
from drivers.modbus.address import TagSpan, locate
from drivers.modbus.factors import ScaledTag, in_order, scaled_tag, spans_of
from drivers.modbus.plan import AddressBlock, RequestLimits, by_block, check_span, plan_spans
from drivers.modbus.settings import ModbusSettings, read_settings
from drivers.survey import PlannedRequest, ReadPlan
from drivers.tag import Tag

_REQUEST_BYTES, _REPLY_HEAD_BYTES = 8, 5
"""Bytes of a read request, and of a reply beside its data, on a serial line (MODBUS over Serial Line V1.02, 2.5)."""


def plan_requests(settings: Mapping[str, Any], tags: Sequence[Tag], written: Sequence[Tag]) -> ReadPlan:
    """The requests of one scan, and those of one write of each block. Raises DriverError for a setting."""
    checked = read_settings(settings)
    limits = checked.limits
    spans: list[TagSpan] = []
    scaled: dict[str, ScaledTag] = {}
    factors: dict[str, TagSpan] = {}
    problems: list[str] = []
    for tag in tags:
        try:
            if tag.scale_from:
                part = scaled_tag(tag, {address: span.tag for address, span in factors.items()})
                span, factors[tag.scale_from] = spans_of(part, limits)
                scaled[tag.name] = part
            else:
                span = check_span(locate(tag, limits.wide), limits)
            spans.append(span)
        except AddressError as error:
            problems.append(str(error))
    blocks, _ = in_order(plan_spans([*spans, *factors.values()], limits), tuple(scaled.values()))
    requests = [
        PlannedRequest(
            kind="read",
            place=f"{block.area}:{block.start}",
            count=block.count,
            # A set: addresses that two tags share are of use once.
            vain=block.count - len({number for span in block.spans for number in range(span.start, span.stop)}),
            tags=tuple(span.tag.name for span in block.spans),
            seconds=_worst(block.count, block, checked),
        )
        for block in blocks
    ]
    writings = [_plan_write(block, checked, limits) for block in by_block(written)]
    writes = tuple(request for requests, _ in writings for request in requests)
    refused = [problem for _, problems in writings for problem in problems]
    seconds = sum(request.seconds for request in requests) + limits.pause * max(0, len(requests) - 1)
    return ReadPlan(
        requests=tuple(requests),
        writes=writes,
        problems=(*problems, *refused),
        seconds=seconds,
        write_seconds=sum(request.seconds for request in writes),
        overlaps=_overlaps(spans),
        written_by=_write_functions(written, checked),
        cautions=_idle_periods(tags, checked),
    )


def _idle_periods(tags: Sequence[Tag], checked: ModbusSettings) -> tuple[str, ...]:
    """That a tag's period saves nothing: behind each new connection there may be another device."""
    paced = [tag.name for tag in tags if tag.period]
    if not paced or not checked.close_between_scans or checked.identity:
        return ()
    others = f" and {len(paced) - 1} others" if len(paced) > 1 else ""
    return (
        f"period: {paced[0]}{others} {'are' if others else 'is'} read with every scan all the same, as with "
        "close_between_scans what was read over one connection is not kept for the next: give identity (plc probe "
        "--write --pin), or take period or close_between_scans out",
    )


def _write_functions(written: Sequence[Tag], checked: ModbusSettings) -> str:
    """By which function a block is written; "" where none is, or where it has no place."""
    try:
        areas = {locate(tag).area for tag in written}
    except AddressError:
        return ""
    said = []
    for area in sorted(areas):
        registers, coils = checked.singly
        several, single = (15, 5) if area.is_bits else (16, 6)
        one_by_one = coils if area.is_bits else registers
        kind = "coil" if area.is_bits else "register"
        said.append(
            f"function {single}, one request a {kind}" if one_by_one else f"function {several}, one request a block"
        )
    back = "read back" if checked.read_back == "late" else "not read back"
    return f"{' and '.join(said)}, {back}" if said else ""


def _worst(count: int, block: AddressBlock, checked: ModbusSettings) -> float:
    """The deadline, and on a serial line the time that the bytes need (s)."""
    octets = (count + 7) // 8 if block.area.is_bits else 2 * count * (1 if block.wide is None else 2)
    wire = rtu.transmission(_REQUEST_BYTES + _REPLY_HEAD_BYTES + octets, checked.baud) if checked.serial else 0.0
    return checked.timeout + wire


def _plan_write(
    written: Sequence[Tag], checked: ModbusSettings, limits: RequestLimits
) -> tuple[tuple[PlannedRequest, ...], tuple[str, ...]]:
    """One write of the block, and the requests that read it back; and what keeps it from being one request."""
    try:
        spans = tuple(sorted((locate(tag, limits.wide) for tag in written), key=lambda span: span.start))
    except AddressError as error:
        return (), (str(error),)
    whole = AddressBlock(spans[0].area, spans[0].start, spans[-1].stop - spans[0].start, spans)
    most = checked.max_write_registers
    problems: tuple[str, ...] = ()
    singly = checked.singly[whole.area.is_bits]
    if whole.count > most and not singly:
        problems = (
            f"the block has {whole.count} words and the device takes {most} in one write: leave fields out "
            "(decanter plc bind --block)",
        )
    requests = [
        PlannedRequest(
            kind="write",
            place=f"{whole.area}:{whole.start}",
            count=whole.count,
            vain=0,
            tags=tuple(span.tag.name for span in spans),
            seconds=_worst(0, whole, checked) * (whole.count if singly else 1),
        )
    ]
    largest = limits.largest(whole.area)
    for start in range(whole.start, whole.stop, largest) if checked.read_back == "late" else ():
        count = min(largest, whole.stop - start)
        seconds = _worst(count, whole, checked)
        requests.append(
            PlannedRequest(
                kind="read back", place=f"{whole.area}:{start}", count=count, vain=0, tags=(), seconds=seconds
            )
        )
    return tuple(requests), problems


def _overlaps(spans: Sequence[TagSpan]) -> tuple[str, ...]:
    """Neighbours of which one begins before the other ends, bits of one register apart."""
    overlaps = []
    for left, right in pairwise(sorted(spans, key=lambda span: (span.area, span.start, span.stop))):
        bits = left.tag.bit is not None and right.tag.bit is not None
        if left.area is right.area and right.start < left.stop and not (bits and left.tag.bit != right.tag.bit):
            places = f"{left.tag.address} ({left.tag.dtype}) and {right.tag.address} ({right.tag.dtype})"
            overlaps.append(f"{left.tag.name} and {right.tag.name} overlap: {places}; correct an address or a type")
    return tuple(overlaps)
