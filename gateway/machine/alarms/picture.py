"""The transition table as a drawing (SVG) and as a Markdown table; nothing in them is written by hand."""

from collections import defaultdict
from collections.abc import Mapping
from html import escape
from math import hypot

from gateway.machine.alarms.states import (
    HIDDEN,
    LETTERS,
    MEANINGS,
    SHOWN,
    TRANSITIONS,
    AlarmState,
    Change,
    Transition,
)

WIDTH, HEIGHT = 900, 700
BOX = (180, 46)
PLACES: Mapping[AlarmState, tuple[float, float]] = {
    AlarmState.NORMAL: (150, 150),
    AlarmState.UNACKNOWLEDGED: (450, 150),
    AlarmState.ACKNOWLEDGED: (750, 150),
    AlarmState.RETURNED: (150, 350),
    AlarmState.LATCHED_UNACKNOWLEDGED: (450, 350),
    AlarmState.LATCHED_ACKNOWLEDGED: (750, 350),
    AlarmState.SHELVED: (150, 600),
    AlarmState.SUPPRESSED: (450, 600),
    AlarmState.OUT_OF_SERVICE: (750, 600),
}
"""The middle of each state's box."""
FRAME = (30, 40, 840, 420)
"""Around the states that are shown: what leads in or out from all of them is one arrow from its border."""
BENT: Mapping[tuple[AlarmState, AlarmState], float] = {
    (AlarmState.ACKNOWLEDGED, AlarmState.NORMAL): -95,
    (AlarmState.LATCHED_ACKNOWLEDGED, AlarmState.NORMAL): 260,
    (AlarmState.SHELVED, AlarmState.OUT_OF_SERVICE): 75,
    (AlarmState.SUPPRESSED, AlarmState.OUT_OF_SERVICE): 40,
}
"""Arrows that go round the boxes between their ends: by how much their middle is moved down."""
PAIR_GAP = 9.0
"""By how much the two arrows of a pair stand apart."""


def row_condition(row: Transition) -> str:
    """When a row holds, in words; "" always."""
    words = {
        "latching": {True: "it latches", False: "it does not latch"},
        "standing": {True: "the condition stands", False: "the condition is over"},
    }
    parts = [text[value] for name, text in words.items() if (value := getattr(row, name)) is not None]
    if row.kept is not None:
        parts.append(f"it had come to rest as {row.kept}")
    return " and ".join(parts)


def transition_table() -> str:
    """Every row of the table, in Markdown; the rows of the states that may be hidden are one for all of them."""
    lines = ["| from | change | when | to |", "|---|---|---|---|"]
    for row in TRANSITIONS:
        if row.target in HIDDEN and row.source in SHOWN:
            continue
        source, target = (f"{LETTERS[state]} {state}" for state in (row.source, row.target))
        lines.append(f"| {source} | {row.change} | {row_condition(row)} | {target} |")
    for hidden, (enter, _) in HIDDEN.items():
        lines.append(f"| {LETTERS[SHOWN[0]]} to {LETTERS[SHOWN[-1]]} | {enter} |  | {LETTERS[hidden]} {hidden} |")
    return "\n".join(lines)


def state_table() -> str:
    """The states with what they say, in Markdown."""
    rows = [f"| {LETTERS[state]} | {state} | {MEANINGS[state]} |" for state in AlarmState]
    return "\n".join(["| | state | meaning |", "|---|---|---|", *rows])


def diagram() -> str:
    """The states and their moves, drawn (SVG)."""
    moves: dict[tuple[AlarmState, AlarmState], list[str]] = defaultdict(list)
    to_all: dict[tuple[AlarmState, bool], set[Change]] = defaultdict(set)
    for row in TRANSITIONS:
        if row.source is row.target:
            continue
        if (row.source in HIDDEN) != (row.target in HIDDEN):
            leaves = row.source in HIDDEN
            to_all[row.source if leaves else row.target, leaves].add(row.change)
        else:
            latching = {True: ", latching", False: "", None: ""}[row.latching]
            moves[row.source, row.target].append(f"{row.change}{latching}")
    arrows = [
        _arrow(source, target, " / ".join(changes), pair=(target, source) in moves)
        for (source, target), changes in moves.items()
    ]
    bottom = FRAME[1] + FRAME[3]
    for (hidden, leaves), changes in to_all.items():
        x, y = PLACES[hidden]
        x += 12 if leaves else -12
        ends = (y - BOX[1] / 2, bottom) if leaves else (bottom, y - BOX[1] / 2)
        label = " / ".join(sorted(changes))
        aside = 3.1 * len(label) + 12
        arrows.append(_line((x, ends[0]), (x, ends[1]), label, aside if leaves else -aside))
    boxes = []
    for state, (x, y) in PLACES.items():
        left, top = x - BOX[0] / 2, y - BOX[1] / 2
        boxes.append(
            f'<rect x="{left:g}" y="{top:g}" width="{BOX[0]}" height="{BOX[1]}" rx="8" fill="#fff" stroke="#334"/>'
            f'<text x="{x:g}" y="{y + 4:g}" text-anchor="middle">{LETTERS[state]} {escape(state)}</text>'
        )
    left, top, width, height = FRAME
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" '
            'font-size="13" role="img" aria-label="The states of an alarm and what leads from one to another">',
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" '
            'orient="auto"><path d="M0 0L8 4L0 8z" fill="#334"/></marker></defs>',
            f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>',
            f'<rect x="{left}" y="{top}" width="{width}" height="{height}" rx="12" fill="#f4f6fa" stroke="#99a" '
            'stroke-dasharray="5 4"/>',
            *arrows,
            *boxes,
            "</svg>",
            "",
        ]
    )


def _arrow(source: AlarmState, target: AlarmState, label: str, *, pair: bool) -> str:
    (x, y), (to_x, to_y) = PLACES[source], PLACES[target]
    if (bend := BENT.get((source, target))) is not None:
        side = BOX[1] / 2 * (1 if bend > 0 else -1)
        # A quadratic curve passes half-way between its control point and the line of its ends.
        middle = ((x + to_x) / 2, (y + to_y) / 2 + bend)
        path = f"M{x:g} {y + side:g}Q{middle[0]:g} {middle[1] + bend / 2:g} {to_x:g} {to_y + side:g}"
        if bend > 200:  # round the corner of the frame: down, along, and up at the left of all boxes
            path = f"M{x:g} {y + side:g}V{y + 85:g}H45V{to_y:g}H{to_x - BOX[0] / 2:g}"
            middle = (300, y + 85)
        return _path(path) + _label(middle, label)
    length = hypot(to_x - x, to_y - y)
    across = ((y - to_y) / length * PAIR_GAP, (to_x - x) / length * PAIR_GAP) if pair else (0.0, 0.0)
    begin, end = (x + across[0], y + across[1]), (to_x + across[0], to_y + across[1])
    return _line(_border(begin, end), _border(end, begin), label, across[0] * 3.5, across[1] * 1.5)


def _border(inside: tuple[float, float], towards: tuple[float, float]) -> tuple[float, float]:
    """Where the line from the middle of a box leaves it."""
    dx, dy = towards[0] - inside[0], towards[1] - inside[1]
    share = min(BOX[0] / 2 / abs(dx) if dx else 1.0, BOX[1] / 2 / abs(dy) if dy else 1.0)
    return inside[0] + dx * share, inside[1] + dy * share


def _line(
    begin: tuple[float, float], end: tuple[float, float], label: str, right: float = 0.0, down: float = 0.0
) -> str:
    middle = ((begin[0] + end[0]) / 2 + right, (begin[1] + end[1]) / 2 + down)
    return _path(f"M{begin[0]:.1f} {begin[1]:.1f}L{end[0]:.1f} {end[1]:.1f}") + _label(middle, label)


def _path(path: str) -> str:
    return f'<path d="{path}" fill="none" stroke="#334" marker-end="url(#tip)"/>'


def _label(middle: tuple[float, float], text: str) -> str:
    width = 6.2 * len(text) + 6
    return (
        f'<rect x="{middle[0] - width / 2:.1f}" y="{middle[1] - 9:.1f}" width="{width:.1f}" height="17" '
        f'fill="#f4f6fa" opacity="0.9"/><text x="{middle[0]:.1f}" y="{middle[1] + 4:.1f}" text-anchor="middle" '
        f'font-size="12" fill="#135">{escape(text)}</text>'
    )
