"""Doors of rooms with large libraries inside: a name is imported at its first use, not with the room (PEP 562)."""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from inspect import getsource
from typing import Any


def lazy_getattr(package: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package whose `__init__` has its imports under `if TYPE_CHECKING:`.

    Those imports are the only list: type checker and import contracts read them as they stand, and here they say
    where a name lies.
    """
    places = {
        alias.name: node.module
        for node in ast.walk(ast.parse(getsource(sys.modules[package])))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(f"{package}.")
        for alias in node.names
    }

    def load_name(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(places[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    return load_name
