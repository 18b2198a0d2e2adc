"""What each library adds to `decanter`'s resident size: `python benchmarks/import_memory.py SOURCE OUT ARGUMENT...`.

SOURCE is the checkout whose code runs. When the program ends, OUT is one JSON object, in MB: what the process "began"
with; for each library by how much it grew while the library's modules were loaded, without those of other libraries
that they load; under "" by how much it grew while none was. Pages of a library that are touched later count there, and
two threads that load at the same time as one.
"""

import json
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path
from resource import getpagesize
from types import ModuleType


def resident() -> float:
    """The resident size of this process (MB)."""
    return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * getpagesize() / 1e6


class Growth:
    """How much the process has grown, by the library that was being loaded (MB)."""

    def __init__(self) -> None:
        self.grown = defaultdict[str, float](float, began=resident())
        self._loading = [""]
        self._size = self.grown["began"]

    def count(self) -> None:
        """Count what has come since the last time."""
        size = resident()
        self.grown[self._loading[-1]] += size - self._size
        self._size = size

    @contextmanager
    def of(self, module: str) -> Iterator[None]:
        """While one of the library's modules is loaded."""
        self.count()
        self._loading.append(module.partition(".")[0])
        try:
            yield
        finally:
            self.count()
            self._loading.pop()


class CountingLoader(Loader):
    """Loads as another one does, counted."""

    def __init__(self, loader: Loader, growth: Growth) -> None:
        self._loader, self._growth = loader, growth

    def __getattr__(self, name: str) -> object:
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """As the other one."""
        with self._growth.of(spec.name):
            return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """As the other one."""
        with self._growth.of(module.__name__):
            self._loader.exec_module(module)


class CountingFinder(MetaPathFinder):
    """Finds as the others do, and has what they find counted."""

    def __init__(self, growth: Growth) -> None:
        self._growth = growth

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """As the first of the others that knows it."""
        for finder in sys.meta_path:
            if finder is not self and (spec := finder.find_spec(name, path, target)) is not None:
                if spec.loader is not None:
                    spec.loader = CountingLoader(spec.loader, self._growth)
                return spec
        return None


def main() -> None:
    source, out = sys.argv[1:3]
    # Not this script's folder, whose modules have the names of libraries.
    sys.path[0] = source
    sys.argv = ["decanter", *sys.argv[3:]]
    growth = Growth()
    sys.meta_path.insert(0, CountingFinder(growth))
    try:
        import_module("gateway.cli.main").main()
    finally:
        growth.count()
        Path(out).write_text(json.dumps(growth.grown), encoding="utf-8")


if __name__ == "__main__":
    main()
