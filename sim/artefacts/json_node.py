"""A parsed JSON document with its file and key path, so that what is wrong is told by where it stands."""

import json
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, TypeVar

from drivers.named_files import unusable
from sim.files import ArtefactError, file_error

T = TypeVar("T")

INFINITIES = {"inf": inf, "-inf": -inf}
"""JSON has no infinity: it is written as a text. NaN is never allowed."""


@dataclass(frozen=True, slots=True)
class JsonNode:
    """A value of the document at `path` (like `locations[2].flow.k`). Every method raises ArtefactError."""

    value: Any
    file: str | Path
    path: str = ""

    def error(self, sentence: str) -> ArtefactError:
        """The error `file: key path: sentence`."""
        return file_error(self.file, None, f"{self.path or 'the document'}: {sentence}")

    def get(self, key: str) -> "JsonNode":
        """The value of a key that must be there."""
        table = self._of_type(dict, "an object {...}")
        if key not in table:
            raise self.error(f"the key {key!r} is missing; it has {', '.join(map(repr, table)) or 'no keys'}")
        return JsonNode(table[key], self.file, f"{self.path}.{key}" if self.path else key)

    def require_keys(self, keys: Collection[str]) -> "JsonNode":
        """Itself, if it is an object with no other keys than these."""
        unknown = [key for key in self._of_type(dict, "an object {...}") if key not in keys]
        if unknown:
            raise self.error(f"the key {unknown[0]!r} is unknown; known are {', '.join(keys)}")
        return self

    def number(self) -> float:
        """A finite number, or the texts "inf" and "-inf"."""
        if isinstance(self.value, str) and self.value in INFINITIES:
            return INFINITIES[self.value]
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):  # true is an int to Python
            raise self.error(f'a number is needed (or "inf"), but this is {_format_value(self.value)}')
        try:
            return float(self.value)
        except OverflowError:
            raise self.error("the number is too large; a 64-bit float is needed") from None

    def text(self) -> str:
        """A text."""
        return str(self._of_type(str, 'a text "..."'))

    def flag(self) -> bool:
        """true or false."""
        return bool(self._of_type(bool, "true or false"))

    def integer(self) -> int:
        """A whole number."""
        if isinstance(self.value, bool):
            raise self.error(f"a whole number is needed, but this is {_format_value(self.value)}")
        return int(self._of_type(int, "a whole number"))

    def each(self) -> Iterator["JsonNode"]:
        """The elements of a list."""
        elements = self._of_type(list, "a list [...]")
        return (JsonNode(element, self.file, f"{self.path}[{index}]") for index, element in enumerate(elements))

    def table(self, read: Callable[["JsonNode"], T]) -> dict[str, T]:
        """An object with keys of its own, each value read by `read`."""
        return {key: read(self.get(key)) for key in self._of_type(dict, "an object {...}")}

    def optional(self, read: Callable[["JsonNode"], T]) -> T | None:
        """None for null, else the value read by `read`."""
        return None if self.value is None else read(self)

    def _of_type(self, wanted: type, description: str) -> Any:
        if not isinstance(self.value, wanted):
            raise self.error(f"{description} is needed, but this is {_format_value(self.value)}")
        return self.value


def _format_value(value: object) -> str:
    if value is None:
        return "null"
    text = json.dumps(value)
    return text if len(text) <= 40 else text[:37] + "..."


def parse_json(text: str, file: str | Path) -> JsonNode:
    """The document. Raises ArtefactError with line and column, also for NaN, Infinity and a key given twice."""
    try:
        document = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        # Where nothing of it is JSON, another file was meant, and there is no place to correct.
        remedy = "correct that place" if text.lstrip()[:1] in ("{", "[") else "give the file that was meant"
        sentence = f"is no JSON ({error.msg} at column {error.colno}); {remedy}"
        raise file_error(file, error.lineno, sentence) from None
    except (ValueError, RecursionError) as error:
        raise file_error(file, None, f"is no JSON that can be used ({error}); correct that place") from None
    if problem := unusable(document):
        raise file_error(file, None, problem)
    return JsonNode(document, file)


def _no_constant(name: str) -> float:
    raise ValueError(f'{name} is no JSON number; write "inf" or "-inf" as texts, and never a NaN')


def _unique(pairs: list[tuple[str, Any]]) -> Mapping[str, Any]:
    # json keeps the last of two equal keys without a word; a model edited by hand would lose a value.
    table = dict(pairs)
    if len(table) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        doubled = next(key for key in table if counts[key] > 1)
        raise ValueError(f"the key {doubled!r} is given twice in one object")
    return table


def written_number(value: float) -> float | str:
    """The number as JSON has it; -0.0 becomes 0.0, as equal models must have one text. ArtefactError for NaN."""
    number = float(value) + 0.0
    if number != number:  # a NaN differs from itself
        raise ArtefactError("a NaN cannot be written into a model; every number of a model must be known")
    return number if abs(number) != inf else ("inf" if number > 0 else "-inf")
