"""The block plan: fewest reads for neighbouring addresses, and what to leave out of them (pure)."""

from collections.abc import Generator, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

from drivers.errors import AddressError
from drivers.modbus.address import Area, TagSpan, WideRange, locate
from drivers.tag import Tag


@dataclass(frozen=True, slots=True)
class RequestLimits:
    """What the device allows: registers and bits a read, addresses read in vain to save a read, pause between (s).

    `wide` are the addresses whose registers have 32 bits.
    """

    max_registers: int = 125
    max_bits: int = 2000
    max_gap: int = 8
    pause: float = 0.0
    wide: tuple[WideRange, ...] = ()

    def largest(self, area: Area, wide: WideRange | None = None) -> int:
        """The most addresses that one read of this table may ask for; of 32-bit registers half as many."""
        if wide is not None:
            return self.max_registers // 2
        return self.max_bits if area.is_bits else self.max_registers

    def joins(self, block: "AddressBlock", span: TagSpan, stop: int) -> bool:
        """Whether one request can read the block and the span up to `stop`: all of it has registers of one width."""
        if block.wide is not None or span.wide is not None:
            return block.wide == span.wide
        return not any(wide.meets(block.area, block.start, stop) for wide in self.wide)


@dataclass(frozen=True, slots=True)
class AddressBlock:
    """One read request and the tags that it answers, none of them split."""

    area: Area
    start: int
    count: int
    spans: tuple[TagSpan, ...]

    @property
    def stop(self) -> int:
        """The first address after it."""
        return self.start + self.count

    @property
    def wide(self) -> WideRange | None:
        """The range of 32-bit registers in which it lies."""
        return self.spans[0].wide if self.spans else None


@dataclass(frozen=True, slots=True)
class RefusedRange:
    """Addresses `start`..`stop - 1` that the device refuses, not to be asked before `retry_at` (s, monotonic).

    An empty range (start == stop) is a seam: the device answers on both sides, but not across it in one request.
    `strikes` counts the refusals in a row, `reason` is the device's.
    """

    area: Area
    start: int
    stop: int
    retry_at: float = 0.0
    strikes: int = 1
    reason: str = ""

    @property
    def is_seam(self) -> bool:
        """True if no address is refused, only a request across it."""
        return self.start == self.stop


Quarantine = tuple[RefusedRange, ...]
_ECHOED_BYTES = 3
"""Bytes of address and count behind the first one, which in a reply says how many follow."""


def plan(tags: Sequence[Tag], limits: RequestLimits, quarantine: Quarantine = ()) -> tuple[AddressBlock, ...]:
    """Give the fewest read requests that answer every tag outside the quarantine, by table and address.

    A tag is never split over two blocks, so a 32-bit value comes from one reply. Raises AddressError for a tag without
    a place in a Modbus device, or wider than one request.
    """
    return plan_spans([check_span(locate(tag, limits.wide), limits) for tag in tags], limits, quarantine)


def plan_spans(
    spans: Iterable[TagSpan], limits: RequestLimits, quarantine: Quarantine = ()
) -> tuple[AddressBlock, ...]:
    """As `plan`, for tags that are already located.

    Taking the lowest address first and every further tag that still fits gives the fewest blocks: the first block must
    reach down to the lowest address anyway, and reaching further up never costs a request. A block whose request
    could also be its reply is two: nothing would tell what a line gives back from what the device says.
    """
    free = [span for span in spans if find_refusal(span, quarantine) is None]
    blocks: list[AddressBlock] = []
    for span in sorted(free, key=lambda span: (span.area, span.start, span.stop)):
        block = blocks[-1] if blocks else None
        # The last block grows if one request can still read it all, if what lies between is worth reading in vain, and
        # if it would not become a request that the device has refused.
        stop = max(block.stop, span.stop) if block is not None else span.stop
        if (
            block is not None
            and block.area is span.area
            and stop - block.start <= limits.largest(block.area, block.wide)
            and limits.joins(block, span, stop)
            and span.start - block.stop <= limits.max_gap
            and not any(_covers_refusal(refusal, block.area, block.start, stop) for refusal in quarantine)
        ):
            blocks[-1] = replace(block, count=stop - block.start, spans=(*block.spans, span))
        else:
            blocks.append(AddressBlock(span.area, span.start, span.count, (span,)))
    return tuple(part for block in blocks for part in (halves(block) if _may_be_reply(block) else None) or (block,))


def _may_be_reply(block: AddressBlock) -> bool:
    """True if address and count of the request can stand for a byte count of 3 and the bits of so many bytes."""
    return block.area.is_bits and block.start >> 8 == _ECHOED_BYTES and -(-block.count // 8) == _ECHOED_BYTES


def check_span(span: TagSpan, limits: RequestLimits) -> TagSpan:
    """The span itself, if one request can read it. Raises AddressError if not."""
    largest = limits.largest(span.area, span.wide)
    if span.count > largest:
        raise AddressError(
            f"{span.tag.name}: it covers {span.count} registers and one request reads {largest}; "
            "a value is never put together from two replies"
        )
    return span


def _covers_refusal(refusal: RefusedRange, area: Area, start: int, stop: int) -> bool:
    """True if a request for start..stop - 1 contains all that was refused, or crosses the seam.

    A request that only shares addresses with a refused one may well be answered: it is not known which was to blame.
    """
    if refusal.area is not area:
        return False
    if refusal.is_seam:
        return start < refusal.start < stop
    return start <= refusal.start and refusal.stop <= stop


def find_refusal(span: TagSpan, quarantine: Quarantine) -> RefusedRange | None:
    """The refusal that forbids to ask for the tag, if any."""
    own = (refusal for refusal in quarantine if not refusal.is_seam)
    return next((refusal for refusal in own if _covers_refusal(refusal, span.area, span.start, span.stop)), None)


# ---------------------------------------------------------------- bisection of a refused block


def halves(block: AddressBlock) -> tuple[AddressBlock, AddressBlock] | None:
    """Cut a refused block between two tags, in a gap nearest to its middle; None if it is one tag or tags in one place.

    Tags that overlap are cut apart only where nothing else can be cut; both halves then ask for the common addresses.
    """
    spans = sorted(block.spans, key=lambda span: (span.start, span.stop))
    reach = [max(span.stop for span in spans[: index + 1]) for index in range(len(spans))]
    places = [(span.start, span.stop) for span in spans]
    cuts = [index for index in range(1, len(spans)) if places[index] != places[index - 1]]
    if not cuts:
        return None
    middle = block.start + block.count / 2

    def badness(index: int) -> tuple[bool, float]:
        stop, start = reach[index - 1], spans[index].start
        return stop > start, abs((stop + start) / 2 - middle)

    cut = min(cuts, key=badness)
    return _block(spans[:cut]), _block(spans[cut:])


def bisect(block: AddressBlock) -> Generator[AddressBlock, bool, tuple[RefusedRange, ...]]:
    """Find what the device refuses in a refused block, without asking anything itself.

    Yields the next block to ask and must be sent whether that one was refused. Returns the refusals, due at once: the
    place of each tag that is refused alone, or a seam where both sides of a cut answer but not both in one request (an
    unreadable gap between them, or a request that is too long for the device).
    """
    cut = halves(block)
    if cut is None:
        return (RefusedRange(block.area, block.start, block.stop),)
    refusals: list[RefusedRange] = []
    refused = False
    for half in cut:
        if (yield half):
            refused = True
            refusals += yield from bisect(half)
    return tuple(refusals) if refused else (RefusedRange(block.area, cut[1].start, cut[1].start),)


def _block(spans: Sequence[TagSpan]) -> AddressBlock:
    start, stop = min(span.start for span in spans), max(span.stop for span in spans)
    return AddressBlock(spans[0].area, start, stop - start, tuple(spans))


def with_refusal(quarantine: Quarantine, refusal: RefusedRange) -> Quarantine:
    """Put the refusal in, in the place of an older one of the same addresses."""
    return (*remove_refusal(quarantine, refusal), refusal)


def remove_refusal(quarantine: Quarantine, refusal: RefusedRange) -> Quarantine:
    """Take the refusal of these addresses out: they answer again."""
    place = (refusal.area, refusal.start, refusal.stop)
    return tuple(other for other in quarantine if (other.area, other.start, other.stop) != place)


def retry_delay(strikes: int, first: float, cap: float) -> float:
    """Seconds until a refused address is asked again: `first`, doubling with every refusal in a row, up to `cap`."""
    return float(min(cap, first * 2 ** min(strikes - 1, 30)))


# ---------------------------------------------------------------- what it costs


def worst_cycle(blocks: Sequence[AddressBlock], limits: RequestLimits, deadline: float) -> float:
    """Longest time (s) that one cycle over the blocks can take: every request meets its deadline only just."""
    return len(blocks) * deadline + max(0, len(blocks) - 1) * limits.pause


def describe(blocks: Sequence[AddressBlock], limits: RequestLimits, deadline: float) -> tuple[str, ...]:
    """The plan in sentences: one line a request, then the worst-case cycle time."""
    lines: list[str] = []
    for block in blocks:
        # Tags may overlap and the longest need not be the last, so a gap begins where the furthest of them ends.
        gaps, reach = 0, block.start
        for left, right in pairwise(block.spans):
            reach = max(reach, left.stop)
            gaps += max(0, right.start - reach)
        vain = f", {gaps} of them in vain" if gaps else ""
        names = ", ".join(span.tag.name for span in block.spans)
        lines.append(f"{block.area}:{block.start} count {block.count}{vain}: {names}")
    registers = sum(block.count for block in blocks)
    worst = worst_cycle(blocks, limits, deadline)
    return (*lines, f"{len(blocks)} requests for {registers} addresses, worst case {worst:.3g} s a cycle")


def by_block(tags: Iterable[Tag]) -> list[list[Tag]]:
    """The tags of a write map, each block's together: the names of a block's words are alike up to their last point.

    A block is one write; two of them are never one, also where their registers are neighbours.
    """
    blocks: dict[str, list[Tag]] = {}
    for tag in tags:
        blocks.setdefault(tag.name.rpartition(".")[0], []).append(tag)
    return list(blocks.values())
