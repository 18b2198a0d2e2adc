from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.errors import AddressError
from drivers.modbus.address import Area, TagSpan, locate, parse_address
from drivers.modbus.plan import (
    AddressBlock,
    RefusedRange,
    RequestLimits,
    bisect,
    describe,
    plan,
    retry_delay,
    worst_cycle,
)
from drivers.modbus.preview import plan_requests
from drivers.tag import DType, Tag


def test_an_address_names_its_table_and_the_pdu_address() -> None:
    assert parse_address("holding:100") == (Area.HOLDING, 100)
    assert parse_address(" coil:0 ") == (Area.COIL, 0)


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("40001", "holding:0"),
        ("40101", "holding:100"),
        ("400101", "holding:100"),
        ("30007", "input:6"),
        ("00001", "coil:0"),
        ("10012", "discrete:11"),
        ("465536", "holding:65535"),
    ],
)
def test_a_reference_number_is_refused_with_the_address_that_it_means(text: str, meant: str) -> None:
    with pytest.raises(AddressError, match=f"write the PDU address {meant}$"):
        parse_address(text)


@pytest.mark.parametrize(
    "text", ["", "holding", "holding:", "holding:-1", "holding:65536", "memory:3", "0x2001:1", "7"]
)
def test_what_is_no_address_is_refused_with_what_would_be(text: str) -> None:
    with pytest.raises(AddressError, match="holding"):
        parse_address(text)


@pytest.mark.parametrize(
    "tag",
    [
        Tag("x", "coil:3"),
        Tag("x", "coil:3", DType.BOOL, bit=0),
        Tag("x", "holding:65535", DType.FLOAT32),
        Tag("x", "holding:0", DType.STRING),
    ],
)
def test_a_tag_that_cannot_lie_at_its_address_is_refused_by_name(tag: Tag) -> None:
    with pytest.raises(AddressError, match=r"^x: "):
        locate(tag)


WIDTHS = {1: DType.UINT16, 2: DType.FLOAT32, 4: DType.FLOAT64}
places = st.lists(st.tuples(st.integers(0, 60), st.sampled_from([1, 2, 4])), min_size=1, max_size=9)


def tags_at(places: list[tuple[int, int]]) -> list[Tag]:
    return [Tag(f"t{i}", f"holding:{start}", WIDTHS[width]) for i, (start, width) in enumerate(places)]


def fewest(spans: list[TagSpan], limits: RequestLimits) -> int:
    """By brute force: the fewest runs of address-ordered tags that each fit one request."""
    ordered = sorted(spans, key=lambda span: (span.start, span.stop))

    def fits(run: list[TagSpan]) -> bool:
        reach = run[0].stop
        for span in run[1:]:
            if span.start - reach > limits.max_gap:
                return False
            reach = max(reach, span.stop)
        return reach - run[0].start <= limits.max_registers

    best = [0] + [len(spans)] * len(spans)
    for end in range(1, len(ordered) + 1):
        best[end] = min(best[begin] + 1 for begin in range(end) if fits(ordered[begin:end]))
    return best[-1]


@settings(max_examples=150)
@given(places=places, max_registers=st.integers(4, 20), max_gap=st.integers(0, 6))
def test_the_plan_reads_every_tag_whole_within_the_limits_with_the_fewest_requests(
    places: list[tuple[int, int]], max_registers: int, max_gap: int
) -> None:
    limits = RequestLimits(max_registers, max_gap=max_gap)
    tags = tags_at(places)
    blocks = plan(tags, limits)
    assert sorted(span.tag.name for block in blocks for span in block.spans) == sorted(tag.name for tag in tags)
    for block in blocks:
        assert block.count <= max_registers
        assert all(block.start <= span.start and span.stop <= block.stop for span in block.spans)
        covered = {number for span in block.spans for number in range(span.start, span.stop)}
        assert {block.start, block.stop - 1} <= covered
        assert all(b - a - 1 <= max_gap for a, b in pairwise(sorted(covered)))
    assert len(blocks) == fewest([locate(tag) for tag in tags], limits)


@settings(max_examples=100)
@given(places=places, start=st.integers(0, 60), width=st.integers(0, 5))
def test_no_request_contains_a_refused_one_or_crosses_a_seam_and_only_refused_tags_are_left_out(
    places: list[tuple[int, int]], start: int, width: int
) -> None:
    tags = tags_at(places)
    blocks = plan(tags, RequestLimits(max_gap=60), (RefusedRange(Area.HOLDING, start, start + width),))
    for block in blocks:
        assert not (width and block.start <= start and start + width <= block.stop)
        assert width or not block.start < start < block.stop or block.count == max(s.count for s in block.spans)
    planned = {span.tag.name for block in blocks for span in block.spans}
    refused = {tag.name for tag in tags if width and locate(tag).start <= start and start + width <= locate(tag).stop}
    assert planned == {tag.name for tag in tags} - refused


def test_a_seam_keeps_neighbours_in_requests_of_their_own() -> None:
    tags = [Tag("a", "holding:1"), Tag("b", "holding:2"), Tag("c", "holding:3")]
    blocks = plan(tags, RequestLimits(), (RefusedRange(Area.HOLDING, 3, 3),))
    assert [(block.start, block.count) for block in blocks] == [(1, 2), (3, 1)]


def test_tables_are_never_mixed_and_bits_have_their_own_limit() -> None:
    tags = [Tag("r", "input:0"), Tag("h", "holding:0"), *(Tag(f"c{n}", f"coil:{n}", DType.BOOL) for n in range(12))]
    blocks = plan(tags, RequestLimits(max_bits=8))
    assert [(block.area, block.count) for block in blocks] == [
        (Area.COIL, 8),
        (Area.COIL, 4),
        (Area.HOLDING, 1),
        (Area.INPUT, 1),
    ]


@settings(max_examples=100)
@given(
    st.sets(st.integers(0x02E0, 0x0420), min_size=1, max_size=60),
    st.integers(0, 30),
    st.sampled_from(("coil", "discrete")),
)
def test_no_request_for_bits_can_be_taken_for_its_reply(numbers: set[int], max_gap: int, table: str) -> None:
    blocks = plan([Tag(f"c{n}", f"{table}:{n}", DType.BOOL) for n in numbers], RequestLimits(max_gap=max_gap))
    assert sorted(span.start for block in blocks for span in block.spans) == sorted(numbers)
    # What follows the function in the request, read as a reply: how many bytes come, then these.
    assert all(not (block.start >> 8 == 3 and 17 <= block.count <= 24) for block in blocks)


def test_a_tag_wider_than_one_request_is_refused_and_not_torn() -> None:
    with pytest.raises(AddressError, match="never put together from two replies"):
        plan([Tag("x", "holding:0", DType.FLOAT64)], RequestLimits(max_registers=3))


def search(
    block: AddressBlock, illegal: set[int], longest: int = 125
) -> tuple[list[AddressBlock], tuple[RefusedRange, ...]]:
    """Drive a bisection against a device that refuses the illegal addresses and too long requests."""
    asked: list[AddressBlock] = []
    steps, refused = bisect(block), None
    while True:
        try:
            part = steps.send(refused)  # type: ignore[arg-type]
        except StopIteration as end:
            return asked, end.value
        asked.append(part)
        refused = bool(illegal & set(range(part.start, part.stop))) or part.count > longest


@settings(max_examples=150)
@given(places=places, illegal=st.sets(st.integers(0, 64), min_size=1, max_size=4))
def test_bisections_leave_a_plan_that_is_never_refused_and_reads_every_readable_tag(
    places: list[tuple[int, int]], illegal: set[int]
) -> None:
    limits, tags = RequestLimits(max_gap=64), tags_at(places)
    quarantine: tuple[RefusedRange, ...] = ()
    readable = {tag.name for tag in tags if not illegal & set(range(locate(tag).start, locate(tag).stop))}
    for _ in range(len(tags) + 1):
        blocks = plan(tags, limits, quarantine)
        refused = [block for block in blocks if illegal & set(range(block.start, block.stop))]
        if not refused:
            break
        for block in refused:
            quarantine += search(block, illegal)[1]
    assert not refused
    assert {span.tag.name for block in blocks for span in block.spans} == readable


def test_one_illegal_register_among_64_is_found_in_few_requests() -> None:
    (block,) = plan([Tag(f"t{n}", f"holding:{n}") for n in range(64)], RequestLimits())
    asked, refusals = search(block, {41})
    assert [(refusal.start, refusal.stop) for refusal in refusals] == [(41, 42)]
    assert len(asked) == 12


def test_an_unreadable_gap_and_a_shorter_limit_of_the_device_are_seams() -> None:
    (block,) = plan([Tag("a", "holding:0"), Tag("b", "holding:5")], RequestLimits())
    assert search(block, {3})[1] == (RefusedRange(Area.HOLDING, 5, 5),)
    (long,) = plan([Tag(f"t{n}", f"holding:{n}") for n in range(64)], RequestLimits())
    seams = search(long, set(), longest=32)[1]
    assert seams == (RefusedRange(Area.HOLDING, 32, 32),)


def test_bits_of_one_register_are_one_place_that_cannot_be_cut() -> None:
    (block,) = plan([Tag(f"b{n}", "holding:7", DType.BOOL, bit=n) for n in range(6)], RequestLimits())
    assert search(block, {7}) == ([], (RefusedRange(Area.HOLDING, 7, 8),))


def test_a_refused_place_waits_twice_as_long_each_time_up_to_the_cap() -> None:
    assert [retry_delay(strikes, 1.0, 10.0) for strikes in (1, 2, 3, 4, 5, 400)] == [1, 2, 4, 8, 10, 10]


def test_the_worst_cycle_counts_every_deadline_and_the_pauses_between() -> None:
    limits = RequestLimits(max_gap=0, pause=0.05)
    blocks = plan([Tag("a", "holding:0"), Tag("b", "holding:10"), Tag("c", "holding:20")], limits)
    assert worst_cycle(blocks, limits, 0.6) == pytest.approx(3 * 0.6 + 2 * 0.05)
    assert worst_cycle((), limits, 0.6) == 0.0


def test_the_plan_is_described_request_by_request() -> None:
    limits = RequestLimits(max_gap=4)
    lines = describe(plan([Tag("a", "holding:0"), Tag("b", "holding:3", DType.FLOAT32)], limits), limits, 0.6)
    assert lines == (
        "holding:0 count 5, 2 of them in vain: a, b",
        "1 requests for 5 addresses, worst case 0.6 s a cycle",
    )


@pytest.mark.parametrize(
    ("own", "said", "writes"),
    [
        ({}, "function 16, one request a block, read back", ["write", "read back"]),
        ({"write_with": 6}, "function 6, one request a register, read back", ["write", "read back"]),
        ({"read_back": "never"}, "function 16, one request a block, not read back", ["write"]),
    ],
)
def test_a_plan_says_by_which_function_a_block_is_written(own: dict[str, object], said: str, writes: list[str]) -> None:
    words = [Tag(f"Writeback.{number}", f"holding:{400 + number}", writable=True) for number in range(4)]
    plan = plan_requests({"host": "h", "timeout": 0.5, **own}, [Tag("T", "holding:1")], words)
    assert (plan.written_by, [request.kind for request in plan.writes]) == (said, writes)
    assert plan.writes[0].seconds == pytest.approx(0.5 * (4 if "write_with" in own else 1))
