"""An interpreter of the Structured Text that the project generates, typed as strictly as matiec is.

It shares nothing with the generator or with the software PLC: it walks the tree of the text. Every value has a type,
nothing is converted unless a standard function does it, and a name that is not declared is an error.
"""

import operator
import struct
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

from lark import Lark, Token, Tree

GRAMMAR = Path(__file__).with_name("iec61131.lark")
ZEROS: dict[str, Any] = {"BOOL": False, "WORD": 0, "UINT": 0, "INT": 0, "REAL": 0.0, "TIME": 0}
BITS, NUMBERS = ("BOOL", "WORD"), ("UINT", "INT", "REAL", "TIME")

Node = Tree[Token]
Typed = tuple[str, Any]
"""A type and a value; a literal without a type is ("literal", value) until something gives it one."""


class Mistake(Exception):
    """The text does what the standard does not allow."""


@cache
def parser() -> Lark:
    return Lark(GRAMMAR.read_text(encoding="utf-8"), parser="lalr")


def single(number: float) -> float:
    """The REAL (32 bits) next to a number."""
    return float(struct.unpack("f", struct.pack("f", number))[0])


class Text:
    """A parsed text: its array types, function blocks, programs and tasks."""

    def __init__(self, text: str) -> None:
        self.tree = parser().parse(text)
        self.arrays: dict[str, tuple[int, int, str]] = {}
        self.blocks: dict[str, Node] = {}
        for node in self.tree.children:
            assert isinstance(node, Tree)
            if node.data == "type_declaration":
                for name, array in zip(node.children[::2], node.children[1::2], strict=True):
                    assert isinstance(array, Tree)
                    low, high, kind = array.children
                    self.arrays[str(name).upper()] = (int(str(low)), int(str(high)), str(kind).upper())
            elif node.data in ("function_block", "program"):
                self.blocks[str(node.children[0]).upper()] = node

    def new(self, name: str) -> "Instance":
        """An instance of a function block or a program, with its variables at their initial values."""
        return Instance(self, self.blocks[name.upper()])

    def initial(self, kind: str) -> Any:
        kind = kind.upper()
        if kind in self.arrays:
            low, high, element = self.arrays[kind]
            return dict.fromkeys(range(low, high + 1), ZEROS[element])
        if kind == "TON":
            return Ton()
        if kind in self.blocks:
            return self.new(kind)
        if kind not in ZEROS:
            raise Mistake(f"type {kind} is not declared")
        return ZEROS[kind]


class Ton:
    """The standard's on-delay timer; times in ms."""

    kinds: Mapping[str, str] = {"in": "BOOL", "pt": "TIME", "q": "BOOL", "et": "TIME"}

    def __init__(self) -> None:
        self.values: dict[str, Any] = {"in": False, "pt": 0, "q": False, "et": 0}
        self._since: int | None = None

    def call(self, now: int, **inputs: Any) -> None:
        self.values.update(inputs)
        if not self.values["in"]:
            self._since = None
        elif self._since is None:
            self._since = now
        spent = 0 if self._since is None else min(now - self._since, self.values["pt"])
        self.values["et"], self.values["q"] = spent, self._since is not None and spent >= self.values["pt"]


class Instance:
    """One function block or program with its memory."""

    def __init__(self, text: Text, node: Node) -> None:
        self.text = text
        self.kinds: dict[str, str] = {}
        self.inputs: set[str] = set()
        self.places: dict[str, str] = {}
        self.values: dict[str, Any] = {}
        self.now = 0
        *blocks, body = node.children[1:]
        self._body = body
        for block in blocks:
            assert isinstance(block, Tree)
            self._declare(block)

    def _declare(self, block: Node) -> None:
        for row in block.children[1:]:
            assert isinstance(row, Tree)
            rest = [child for child in row.children if child is not None]
            name = str(rest.pop(0)).lower()
            if name in self.kinds:
                raise Mistake(f"{name} is declared twice")
            if isinstance(rest[0], Tree) and rest[0].data == "location":
                self.places[name] = str(rest.pop(0).children[0])
            kind = str(rest.pop(0)).upper()
            self.kinds[name] = kind
            self.values[name] = self.text.initial(kind)
            if rest:
                self.values[name] = self._as(kind, self._value(rest[0]))
            if str(block.children[0]).upper() == "VAR_INPUT":
                self.inputs.add(name)

    def call(self, now: int, **inputs: Any) -> None:
        """Run the body once at `now` (ms). Inputs that are not given keep their values."""
        for name, value in inputs.items():
            if name.lower() not in self.inputs and self.inputs:
                raise Mistake(f"{name} is no input")
            self.values[name.lower()] = dict(value) if isinstance(value, dict) else value
        self.now = now
        self._run(self._body)

    def __getitem__(self, name: str) -> Any:
        return self.values[name.lower()]

    # ---------------------------------------------------------------- statements

    def _run(self, statements: Any) -> None:
        for one in statements.children:
            getattr(self, f"_{one.data}")(one)

    def _assignment(self, node: Node) -> None:
        place, expression = node.children
        assert isinstance(place, Tree)
        name = str(place.children[0]).lower()
        kind = self._kind(name)
        value = self._value(expression)
        if len(place.children) == 1:
            if name in self.inputs:
                raise Mistake(f"{name} is an input and is assigned")
            self.values[name] = self._as(kind, value)
            return
        low, high, element = self.text.arrays[kind]
        index = self._index(place.children[1], low, high, name)
        self.values[name][index] = self._as(element, value)

    def _call(self, node: Node) -> None:
        name = str(node.children[0]).lower()
        target = self.values[name]
        kinds = target.kinds
        given: dict[str, Any] = {}
        for argument in node.children[1:]:
            assert isinstance(argument, Tree)
            key = str(argument.children[0]).lower()
            given[key] = self._as(kinds[key], self._value(argument.children[1]))
        target.call(self.now, **given)

    def _if_statement(self, node: Node) -> None:
        condition, body, *others = node.children
        if self._truth(condition):
            self._run(body)
            return
        for other in others:
            if isinstance(other, Tree) and other.data == "else_part":
                self._run(other.children[0])
            elif isinstance(other, Tree) and self._truth(other.children[0]):
                self._run(other.children[1])
                return

    def _for_statement(self, node: Node) -> None:
        name = str(node.children[0]).lower()
        kind = self._kind(name)
        first, last = (self._as(kind, self._value(one)) for one in node.children[1:3])
        for number in range(first, last + 1):
            self.values[name] = number
            self._run(node.children[3])

    # ---------------------------------------------------------------- expressions

    def _kind(self, name: str) -> str:
        if name not in self.kinds:
            raise Mistake(f"{name} is not declared")
        return self.kinds[name]

    def _truth(self, node: Any) -> bool:
        return bool(self._as("BOOL", self._value(node)))

    def _index(self, node: Any, low: int, high: int, name: str) -> int:
        kind, index = self._value(node)
        if kind not in ("INT", "UINT", "literal") or not low <= index <= high:
            raise Mistake(f"{name}[{index}] of type {kind} is outside {low}..{high}")
        return int(index)

    def _as(self, kind: str, value: Typed) -> Any:
        own, content = value
        if own == kind:
            return dict(content) if isinstance(content, dict) else content
        if own != "literal" or kind == "TIME" or (isinstance(content, bool) != (kind == "BOOL")):
            raise Mistake(f"a {own} stands where a {kind} belongs")
        if isinstance(content, float) and kind != "REAL":
            raise Mistake(f"{content} stands where a {kind} belongs")
        return single(content) if kind == "REAL" else content

    def _value(self, node: Any) -> Typed:
        rule = node.data
        if rule in _OPERATORS:
            left, right = (self._value(child) for child in node.children)
            return _OPERATORS[rule](rule, left, right)
        result: Typed = getattr(self, f"_{rule}")(node)
        return result

    def _variable(self, node: Node) -> Typed:
        name = str(node.children[0]).lower()
        kind = self._kind(name)
        if len(node.children) == 1:
            return kind, self.values[name]
        inner = node.children[1]
        if isinstance(inner, Token):
            target = self.values[name]
            return target.kinds[inner.lower()], target.values[inner.lower()]
        low, high, element = self.text.arrays[kind]
        return element, self.values[name][self._index(inner, low, high, name)]

    def _function(self, node: Node) -> Typed:
        name = str(node.children[0]).upper()
        if name not in _FUNCTIONS:
            raise Mistake(f"{name} is no standard function that this reads")
        return _FUNCTIONS[name](*(self._value(child) for child in node.children[1:]))

    def _not_(self, node: Node) -> Typed:
        kind, value = self._value(node.children[0])
        if kind not in BITS:
            raise Mistake(f"NOT of a {kind}")
        return kind, not value if kind == "BOOL" else ~value & 0xFFFF

    def _typed(self, node: Node) -> Typed:
        kind, _, digits = str(node.children[0]).partition("#")
        number = int(digits[3:], 16) if digits.startswith("16#") else int(digits)
        return kind.upper(), _fits(kind.upper(), number)

    def _duration(self, node: Node) -> Typed:
        return "TIME", int(str(node.children[0]).partition("#")[2].lower().removesuffix("ms"))

    def _real(self, node: Node) -> Typed:
        return "literal", float(str(node.children[0]))

    def _integer(self, node: Node) -> Typed:
        return "literal", int(str(node.children[0]))

    def _boolean(self, node: Node) -> Typed:
        return "BOOL", str(node.children[0]).upper() == "TRUE"


# ---------------------------------------------------------------- without state


def _fits(kind: str, number: int) -> int:
    low, high = (-0x8000, 0x7FFF) if kind == "INT" else (0, 0xFFFF)
    if not low <= number <= high:
        raise Mistake(f"{number} overflows a {kind}")
    return number


def _common(left: Typed, right: Typed) -> str:
    kinds = {left[0], right[0]} - {"literal"}
    if len(kinds) != 1:
        raise Mistake(f"a {left[0]} with a {right[0]}")
    return kinds.pop()


def _logic(rule: str, left: Typed, right: Typed) -> Typed:
    kind = _common(left, right)
    if kind not in BITS:
        raise Mistake(f"{rule} of a {kind}")
    return kind, {"and_": operator.and_, "or_": operator.or_, "xor_": operator.xor}[rule](left[1], right[1])


def _comparison(rule: str, left: Typed, right: Typed) -> Typed:
    kind = _common(left, right)
    signs = {"equal": "eq", "unequal": "ne", "less": "lt", "greater": "gt", "at_most": "le", "at_least": "ge"}
    if kind not in (*BITS, *NUMBERS):
        raise Mistake(f"a {kind} is compared")
    one, other = (single(value[1]) if kind == "REAL" else value[1] for value in (left, right))
    return "BOOL", getattr(operator, signs[rule])(one, other)


def _arithmetic(rule: str, left: Typed, right: Typed) -> Typed:
    kind = _common(left, right)
    if kind not in NUMBERS:
        raise Mistake(f"{rule} of a {kind}")
    act = {"add": operator.add, "subtract": operator.sub, "multiply": operator.mul, "modulo": operator.mod}[rule]
    if kind == "REAL":
        return kind, single(act(single(left[1]), single(right[1])))
    return kind, _fits(kind, act(left[1], right[1]))


_OPERATORS: dict[str, Callable[[str, Typed, Typed], Typed]] = {
    **dict.fromkeys(("and_", "or_", "xor_"), _logic),
    **dict.fromkeys(("equal", "unequal", "less", "greater", "at_most", "at_least"), _comparison),
    **dict.fromkeys(("add", "subtract", "multiply", "modulo"), _arithmetic),
}


def _converted(source: str, target: str, act: Callable[[Any], Any]) -> Callable[..., Typed]:
    def convert(value: Typed) -> Typed:
        if value[0] != source:
            raise Mistake(f"{source}_TO_{target} of a {value[0]}")
        return target, act(value[1])

    return convert


def _shift_left(value: Typed, by: Typed) -> Typed:
    if value[0] != "WORD" or by[0] not in ("literal", "INT", "UINT"):
        raise Mistake(f"SHL of a {value[0]} by a {by[0]}")
    return "WORD", value[1] << by[1] & 0xFFFF


def _rotate_left(value: Typed, by: Typed) -> Typed:
    if value[0] != "WORD" or by[0] not in ("literal", "INT", "UINT"):
        raise Mistake(f"ROL of a {value[0]} by a {by[0]}")
    return "WORD", (value[1] << by[1] | value[1] >> (16 - by[1])) & 0xFFFF


_FUNCTIONS: dict[str, Callable[..., Typed]] = {
    "SHL": _shift_left,
    "ROL": _rotate_left,
    "WORD_TO_UINT": _converted("WORD", "UINT", int),
    "WORD_TO_INT": _converted("WORD", "INT", lambda word: word - 0x10000 if word & 0x8000 else word),
    "UINT_TO_WORD": _converted("UINT", "WORD", int),
    "UINT_TO_REAL": _converted("UINT", "REAL", lambda number: single(float(number))),
    "INT_TO_REAL": _converted("INT", "REAL", lambda number: single(float(number))),
}
