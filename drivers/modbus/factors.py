"""Factors that a device has in registers of their own, as SunSpec's: the raw number times ten to that (pure).

A value and its factor that come in one reply belong together. Of two replies it is not known whether the device has
changed the factor between them: such a value counts where the factor was the same before it and after it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from drivers.codec import judge
from drivers.errors import AddressError
from drivers.modbus.address import TagSpan, locate
from drivers.modbus.plan import AddressBlock, RequestLimits, check_span
from drivers.tag import DType, Quality, Sample, Tag

_NOT_THERE = -0x8000
_MOST = 10
"""SunSpec Information Model Specification, 4.3.4 sunssf: -10 to 10, and 0x8000 for a factor that is not implemented."""


@dataclass(frozen=True, slots=True)
class ScaledTag:
    """A tag with a factor in a register: what is read of it is `raw`, a bare number, and `factor`."""

    tag: Tag
    raw: Tag
    factor: Tag


def scaled_tag(tag: Tag, factors: Mapping[str, Tag]) -> ScaledTag:
    """The two that are read for a tag; `factors` are those of others, by their addresses."""
    raw = replace(tag, scale=1.0, offset=0.0, low=None, high=None, labels={}, scale_from="", period=0.0)
    known = factors.get(tag.scale_from)
    return ScaledTag(tag, raw, known or _factor(tag.scale_from))


def _factor(address: str) -> Tag:
    return Tag(f"factor at {address}", address, DType.INT16, sentinel=_NOT_THERE, low=-_MOST, high=_MOST)


def spans_of(part: ScaledTag, limits: RequestLimits) -> tuple[TagSpan, TagSpan]:
    """Where its raw number and its factor lie. Raises AddressError."""
    if part.tag.bit is not None or part.tag.dtype in (DType.BOOL, DType.STRING):
        raise AddressError(f"{part.tag.name}: a {part.tag.dtype} has no scale; take scale_from out")
    try:
        factor = locate(part.factor, limits.wide)
    except AddressError as error:
        raise AddressError(f"{part.tag.name}: scale_from: {error}") from None
    if factor.area.is_bits:
        raise AddressError(f"{part.tag.name}: scale_from: {part.tag.scale_from} is one bit; give a register")
    return check_span(locate(part.raw, limits.wide), limits), factor


def in_order(
    blocks: Sequence[AddressBlock], parts: Sequence[ScaledTag]
) -> tuple[tuple[AddressBlock, ...], tuple[AddressBlock, ...]]:
    """(the blocks, factors that are not in one block with all of their values behind these; those factors alone)."""
    factors = {id(part.factor) for part in parts}
    ordered = sorted(blocks, key=lambda block: any(id(span.tag) in factors for span in block.spans))
    at = {id(span.tag): place for place, block in enumerate(ordered) for span in block.spans}
    lone: dict[int, AddressBlock] = {}
    early: dict[int, AddressBlock] = {}
    for part in parts:
        own, its = at.get(id(part.raw)), at.get(id(part.factor))
        if own is None or its is None or own == its:
            continue
        span = next(span for span in ordered[its].spans if span.tag is part.factor)
        lone[id(part.factor)] = AddressBlock(span.area, span.start, span.count, (span,))
        if its < own:  # two blocks that have each other's factors
            early[id(part.factor)] = lone[id(part.factor)]
    return (*ordered, *early.values()), tuple(lone.values())


def scaled_sample(part: ScaledTag, raw: Sample, factor: Sample, before: int | None) -> Sample:
    """The tag's reading; `before` is the factor that was read before this scan."""
    tag = part.tag
    if raw.value is None or isinstance(raw.value, str):
        return raw
    place = tag.scale_from
    if not factor.quality.is_good or not isinstance(factor.value, int):
        return replace(raw, value=None, quality=factor.quality, reason=f"its factor at {place}: {factor.reason}")
    together = (raw.sent, raw.time) == (factor.sent, factor.time)
    after = raw.sent is not None and factor.sent is not None and factor.sent >= raw.sent
    if not together and not (after and before == factor.value):
        reason = f"its factor at {place} was another one while it was read, or that is not known"
        # As if nothing had been asked: a tag with a period of its own is asked for again with the next scan.
        return replace(raw, value=None, quality=Quality.NO_DATA, sent=None, reason=reason)
    power = factor.value
    number = raw.value * 10**power if power >= 0 else raw.value / 10**-power
    value = number if tag.scale == 1.0 and tag.offset == 0.0 else number * tag.scale + tag.offset
    quality, reason = judge(tag, value)
    if quality.is_good:  # what was doubted of the raw number stays doubted
        quality, reason = raw.quality, raw.reason
    return replace(raw, value=value, quality=quality, reason=reason)
