"""Drivers say what they can do as data: nobody asks for a driver's name, and the data is true."""

import ast
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.capabilities import Capabilities
from drivers.driver import DRIVERS, LINKS, capabilities, link_name, load_function
from drivers.errors import DriverError
from drivers.survey import open_bus_survey, open_registers, read_plan

ROOT = Path(__file__).parents[2]
NAMES = {*DRIVERS, *LINKS}
# "can" is also what frames are (drivers.tap.Medium), and a face of the software PLC; neither is a driver.
MEDIA = ("medium",)
FACES = ("sim/plc/faces.py", "sim/plc/program/faults.py", "sim/plc/can/face.py")


def _names_in(node: ast.AST) -> set[str]:
    return {
        part.value
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str) and part.value in NAMES
    }


def _asks_for_a_name(node: ast.AST) -> bool:
    """True for a comparison with a name, `in` some, `startswith` one, a `case` of one, and a table by names."""
    match node:
        case ast.Compare(left=left, comparators=others):
            parts = (left, *others)
            if any(isinstance(part, ast.Attribute) and part.attr in MEDIA for part in parts):
                return False
            plain = (part for part in parts if isinstance(part, ast.Constant | ast.Tuple | ast.Set | ast.List))
            return any(map(_names_in, plain))
        case ast.Call(func=ast.Attribute(attr="startswith" | "endswith"), args=arguments):
            return any(_names_in(argument) for argument in arguments)
        case ast.MatchValue(value=value):
            return bool(_names_in(value))
        case ast.Set(elts=elements) | ast.Dict(keys=elements) if elements:
            keys = [key.value for key in elements if isinstance(key, ast.Constant)]
            return len(keys) == len(elements) and all(key in NAMES for key in keys)
    return False


def _places() -> Iterator[str]:
    tables = ("drivers/driver.py", "gateway/demo/links.py", *FACES)
    for package in ("drivers", "sim", "gateway"):
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            text = path.read_text(encoding="utf-8")
            if name not in tables and any(f"{quote}{each}{quote}" in text for each in NAMES for quote in "\"'"):
                tree = ast.parse(text)
                yield from (f"{name}:{node.lineno}" for node in ast.walk(tree) if _asks_for_a_name(node))


def test_nobody_asks_for_the_name_of_a_driver() -> None:
    assert list(_places()) == []


@pytest.mark.parametrize(
    "source",
    [
        'if target.driver == "modbus": pass',
        'if "can" != kind: pass',
        'if driver in ("can", "canopen"): pass',
        'SPEAKS = frozenset({"can", "canopen"})',
        'OWN = {"can": 1}',
        'kind.startswith("modbus-rtu")',
        'match driver:\n  case "soft": pass',
    ],
)
def test_every_way_of_asking_for_a_name_is_noticed(source: str) -> None:
    assert any(_asks_for_a_name(node) for node in ast.walk(ast.parse(source)))


@pytest.mark.parametrize("name", DRIVERS)
def test_what_a_row_names_is_there(name: str) -> None:
    row = DRIVERS[name]
    for target in (row.opens, row.surveys, row.plans, row.decodes):
        assert target == "" or callable(load_function(target))
    assert not (row.registers or row.nodes or row.bus) or row.surveys


def test_a_link_is_named_by_its_settings() -> None:
    assert all(link.driver in DRIVERS for link in LINKS.values())
    for name, link in LINKS.items():
        assert link_name(link.driver, link.settings) == name
    assert link_name("modbus", {"serial": "/dev/ttyS0"}) == "modbus-rtu"
    assert link_name("modbus", {"transport": "tcp", "serial": "/dev/ttyS0"}) == "modbus"
    assert link_name("modbus", {"transport": "udp"}) == "modbus-udp"
    assert link_name("soft", {}) == "soft"


def test_what_a_driver_lacks_is_refused_in_a_sentence() -> None:
    with pytest.raises(DriverError, match="'canopen' has no registers"):
        open_registers("canopen", {}, clock=time.time)
    with pytest.raises(DriverError, match="'modbus' is no CAN bus"):
        open_bus_survey("modbus", {}, clock=time.time)
    with pytest.raises(DriverError, match="unknown driver 'profinet': known are can, can-log, canopen, modbus, soft"):
        capabilities("profinet")
    assert read_plan("soft", {}, ()) is None


def test_a_new_row_has_nothing_that_it_does_not_say() -> None:
    row = Capabilities(opens="somewhere:open")
    assert not any((row.speaks, row.registers, row.units, row.nodes, row.bus, row.writes, row.networked))
