"""A name is imported from the module that defines it, or by a door: no other module hands on what it imports."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
FLOORS = ("drivers", "sim", "gateway")


def modules(root: Path) -> dict[str, ast.Module]:
    """The product's modules by their dotted names, without the doors of packages."""
    paths = [path for floor in FLOORS for path in (root / floor).rglob("*.py") if path.name != "__init__.py"]
    return {".".join(path.relative_to(root).with_suffix("").parts): ast.parse(path.read_bytes()) for path in paths}


def imported(tree: ast.Module) -> set[str]:
    """The names that a module has from others."""
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    return {alias.asname or alias.name for node in nodes for alias in node.names}


def handed_on(trees: dict[str, ast.Module], importers: list[ast.Module]) -> Iterator[str]:
    """Each import of a name that the module it is taken from has itself imported."""
    foreign = {name: imported(tree) for name, tree in trees.items()}
    for tree in importers:
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and node.module in foreign:
                yield from (f"{node.module}.{a.name}" for a in node.names if a.name in foreign[node.module])


def test_no_module_but_a_door_hands_on_what_it_imports() -> None:
    doors = [ast.parse(path.read_bytes()) for floor in FLOORS for path in (ROOT / floor).rglob("__init__.py")]
    trees = modules(ROOT)
    assert list(handed_on(trees, [*trees.values(), *doors])) == []


def test_what_is_handed_on_is_found() -> None:
    trees = {"sim.near": ast.parse("from sim.far import Thing"), "sim.far": ast.parse("class Thing: ...")}
    assert list(handed_on(trees, [ast.parse("from sim.near import Thing")])) == ["sim.near.Thing"]
    assert list(handed_on(trees, [ast.parse("from sim.far import Thing")])) == []
