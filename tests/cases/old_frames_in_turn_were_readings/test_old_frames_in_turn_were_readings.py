"""A multiplexed message whose last frames, one of each layout, were repeated in turn gave a reading in each round.

Two frames had to follow a jump of the counter; of three that are repeated in turn two do.
"""

from pathlib import Path

import pytest

from drivers.can import Dbc
from drivers.can.frame import CanFrame
from drivers.can.protection import Protection, protect_frame
from drivers.can.reception import MessageRules, Reception
from tests.rig.pair import ROOT

HEAD = 'VERSION ""\nBU_: X\nBO_ 1 Pages: 8 X\n'
TAIL = '\nBA_DEF_ BO_ "E2EProfile" STRING;\nBA_DEF_DEF_ "E2EProfile" "none";\nBA_ "E2EProfile" BO_ 1 "P05";\n'
PAGE = ' SG_ Page M : 24|8@1+ (1,0) [0|0] "" X\n'
PLAIN = ' SG_ A : 32|8@1+ (1,0) [0|0] "" X\n'
SIX = PAGE + "".join(f' SG_ A{page} m{page} : 32|8@1+ (1,0) [0|0] "" X\n' for page in range(6))
PAGES_IN_A_PAGE = (
    PAGE
    + ' SG_ Sub m1M : 32|8@1+ (1,0) [0|0] "" X\n SG_ A m0 : 40|8@1+ (1,0) [0|0] "" X\n'
    + "".join(f' SG_ B{page} m{page} : 40|8@1+ (1,0) [0|0] "" X\n' for page in range(3))
)
OF_A_PAGE = "SG_MUL_VAL_ 1 Sub Page 1-1;\nSG_MUL_VAL_ 1 A Page 0-0;\n"
OF_A_PAGE += "".join(f"SG_MUL_VAL_ 1 B{page} Sub {page}-{page};\n" for page in range(3))
INDEXED = PAGE + ' SG_ X m0 : 32|8@1+ (1,0) [0|0] "" X\n SG_ Y m1 : 40|8@1+ (1,0) [0|0] "" X\n'
ONE_OF_255 = "SG_MUL_VAL_ 1 X Page 0-0;\nSG_MUL_VAL_ 1 Y Page 1-255;\n"
PAGES_IN_EACH_PAGE = PAGE + "".join(
    f' SG_ {sub} m{page}M : 32|8@1+ (1,0) [0|0] "" X\n'
    + "".join(f' SG_ {sub}{number} m{number} : 40|8@1+ (1,0) [0|0] "" X\n' for number in range(4))
    for page, sub in enumerate("FG")
)
OF_EACH_PAGE = "".join(
    f"SG_MUL_VAL_ 1 {sub} Page {page}-{page};\n"
    + "".join(f"SG_MUL_VAL_ 1 {sub}{number} {sub} {number}-{number};\n" for number in range(4))
    for page, sub in enumerate("FG")
)
OVERLAPPING = "SG_MUL_VAL_ 1 X Page 0-9;\nSG_MUL_VAL_ 1 Y Page 5-255;\n"
TWO_IN_A_PAGE = "".join(
    f"SG_MUL_VAL_ 1 {sub} Page 0-0;\n"
    + "".join(f"SG_MUL_VAL_ 1 {sub}{number} {sub} {number}-{number};\n" for number in range(4))
    for sub in "FG"
)


def used(guard: Protection | None, counters: list[int]) -> list[bool]:
    """Whether each frame of these counters is a reading."""
    assert guard is not None
    reception = Reception()
    reception.listen(MessageRules(1, "Pages", 8, guard), (), 1.0, 0.0)
    frames = [CanFrame(0.0, 1, False, protect_frame(guard, counter, bytes(8))) for counter in counters]
    return [bool(reception.take(1, frame, 0.0)) for frame in frames]


@pytest.mark.parametrize("name", ["Service", "ServiceAlimentazione"])
def test_the_device_files_pages_repeated_in_turn_are_no_readings(name: str) -> None:
    guard = Dbc(ROOT / "config/decanter.dbc").messages[name].protection
    assert all(used(guard, list(range(20))))
    for pages in (1, 2, 3):
        assert not any(used(guard, [*range(20), *[*range(20 - pages, 20)] * 30])[20:])
    assert used(guard, [*range(20), *range(100, 105)])[20:] == [False, False, False, True, True]


@pytest.mark.parametrize(
    ("signals", "selections", "frames"),
    [(PLAIN, "", 2), (SIX, "", 6), (PAGES_IN_A_PAGE, OF_A_PAGE, 4)],
    ids=["plain", "six pages", "pages in a page"],
)
def test_as_many_frames_must_follow_a_jump_as_a_message_has_layouts(
    tmp_path: Path, signals: str, selections: str, frames: int
) -> None:
    path = tmp_path / "pages.dbc"
    path.write_text(HEAD + signals + TAIL + selections, encoding="cp1252")
    guard = Dbc(path).messages["Pages"].protection
    assert not any(used(guard, [*range(20), *[*range(20 - frames, 20)] * 30])[20:])
    assert used(guard, [*range(20), *range(100, 120)])[-1]


@pytest.mark.parametrize(
    ("signals", "selections", "layouts"),
    [
        (PLAIN, "", 1),
        (SIX, "", 6),
        (INDEXED, ONE_OF_255, 2),
        (INDEXED, OVERLAPPING, 3),
        (PAGES_IN_A_PAGE, OF_A_PAGE, 4),
        (PAGES_IN_EACH_PAGE, OF_EACH_PAGE, 8),
        (PAGES_IN_EACH_PAGE, TWO_IN_A_PAGE, 16),
    ],
    ids=[
        "plain",
        "six pages",
        "255 numbers of one",
        "ranges overlap",
        "in one page",
        "in each page",
        "two in one page",
    ],
)
def test_numbers_of_one_layout_are_one_and_pages_that_exclude_one_another_add_up(
    tmp_path: Path, signals: str, selections: str, layouts: int
) -> None:
    """A message of two layouts had to be seen for 255 frames: bad for four minutes after each restart of its device."""
    path = tmp_path / "pages.dbc"
    path.write_text(HEAD + signals + TAIL + selections, encoding="cp1252")
    facts = Dbc(path).messages["Pages"]
    assert facts.layouts == layouts
    assert facts.protection is not None
    needed = max(2, layouts)
    assert used(facts.protection, [0, *range(100, 100 + needed + 1)]) == [True, *[False] * needed, True]
