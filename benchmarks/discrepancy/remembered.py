"""Results of pure functions kept by the content of their arguments, and by the rules that they read.

A diagnosis under rules of which one is another repeats nearly all of the work of the one before. What a `Memory` stands
in for is run again only where an argument differs, or a rule that was read while it ran.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass
from enum import Enum
from functools import wraps
from hashlib import blake2b
from types import ModuleType
from typing import Any

import numpy as np

from sim.lab.discrepancy.rules import RULES, DecisionRules

NAMES = frozenset(each.name for each in fields(DecisionRules))
PLAIN = (type(None), bool, int, float, complex, str, bytes, Enum)


class WatchedRules(DecisionRules):
    """Rules that note in the `memory` which of them are read."""

    __slots__ = ("memory",)
    memory: "Memory"

    def __getattribute__(self, name: str) -> Any:
        if name in NAMES:
            object.__getattribute__(self, "memory").read(name)
        return object.__getattribute__(self, name)


class WorkLimitError(Exception):
    """More work would be new than was allowed."""


@dataclass(slots=True)
class Memory:
    """What was worked out, by function and content; `fresh` counts what was new since it was set to 0.

    `limit` is how often a function named `counted` may be run anew before WorkLimitError.
    """

    counted: str = ""
    limit: float = np.inf
    fresh: int = 0
    rules: DecisionRules = RULES
    _known: dict[bytes, list[tuple[dict[str, Any], Any]]] = field(default_factory=dict)
    _digests: dict[int, tuple[object, bytes]] = field(default_factory=dict)
    _kept: list[object] = field(default_factory=list)
    _reading: list[set[str]] = field(default_factory=list)

    def under(self, rules: DecisionRules) -> DecisionRules:
        """The same rules, with their reading noted here: what is asked from now on is asked under them."""
        watched = WatchedRules(**{name: getattr(rules, name) for name in NAMES})
        object.__setattr__(watched, "memory", self)
        self.rules, self.fresh = rules, 0
        return watched

    def read(self, name: str) -> None:
        """A rule was read: all that runs now hangs on it."""
        for each in self._reading:
            each.add(name)

    @contextmanager
    def noting(self) -> Iterator[set[str]]:
        """The names of the rules that are read inside the block."""
        noted = set[str]()
        self._reading.append(noted)
        try:
            yield noted
        finally:
            self._reading.pop()

    def remembering(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, run only for what it was not run for before."""

        @wraps(function)
        def call(*args: Any, **options: Any) -> Any:
            key = self.digest((function.__module__, function.__qualname__, args, tuple(sorted(options.items()))))
            known = self._known.setdefault(key, [])
            for hangs_on, result in known:
                if all(getattr(self.rules, name) == value for name, value in hangs_on.items()):
                    for name in hangs_on:
                        self.read(name)
                    return result
            if function.__name__ == self.counted:
                self.fresh += 1
                if self.fresh > self.limit:
                    raise WorkLimitError
            with self.noting() as noted:
                result = function(*args, **options)
            known.append(({name: getattr(self.rules, name) for name in noted}, result))
            return result

        return call

    @contextmanager
    def standing_in(self, names: Mapping[ModuleType, tuple[str, ...]]) -> Iterator[None]:
        """Inside the block the functions of these names are remembered in these modules."""
        before = [(module, name, getattr(module, name)) for module, each in names.items() for name in each]
        try:
            for module, name, function in before:
                setattr(module, name, self.remembering(function))
            yield
        finally:
            for module, name, function in before:
                setattr(module, name, function)

    @contextmanager
    def light(self) -> Iterator[None]:
        """Digests that are made inside the block are forgotten after it, and with them what they keep."""
        count = len(self._digests)
        try:
            yield
        finally:
            for key in list(self._digests)[count:]:
                del self._digests[key]

    def digest(self, value: object) -> bytes:
        """What tells a value from others by its content; rules are left out, and what is neither data nor a table is
        told by its identity."""
        if isinstance(value, PLAIN):
            return f"{type(value).__name__}:{value!r};".encode()
        if isinstance(value, WatchedRules):
            return b"rules;"
        if isinstance(value, list | dict):
            return self._made(value)
        known = self._digests.get(id(value))
        if known is None:
            # The value is kept with its digest, so that nothing else can have its identity.
            known = self._digests[id(value)] = (value, self._made(value))
        return known[1]

    def _made(self, value: object) -> bytes:
        made = blake2b(type(value).__qualname__.encode(), digest_size=16)
        if isinstance(value, np.ndarray):
            made.update(f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes())
        elif isinstance(value, np.generic):
            made.update(value.tobytes())
        elif is_dataclass(value) and not isinstance(value, type):
            for each in fields(value):
                made.update(self.digest(getattr(value, each.name)))
        elif isinstance(value, Mapping):
            for key, each in value.items():
                made.update(self.digest(key) + self.digest(each))
        elif isinstance(value, tuple | list):
            for each in value:
                made.update(self.digest(each))
        elif isinstance(value, frozenset | set):
            for digest in sorted(self.digest(each) for each in value):
                made.update(digest)
        else:
            self._kept.append(value)
            made.update(str(id(value)).encode())
        return made.digest()
