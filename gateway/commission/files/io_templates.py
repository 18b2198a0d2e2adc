"""Register lists of other programs in YAML: Home Assistant's `modbus:` and evcc's meter templates, as rows.

Only nodes are looked at, so that tags such as `!secret` run nothing, and each row keeps the line at which it stands.
What a program writes, computes or decides by a setting of its own is a row too, with the reason why it is no tag.
"""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivers.errors import OneLineError
from gateway.commission.files.cells import ListRow

MOST_NODES = 200_000
_MOST_DEPTH = 60
_WRITTEN = ("switches", "climates", "covers", "fans", "lights")
"""Entities of Home Assistant that write."""
_UNIT_KEYS = ("device_address", "slave", "unit")
_TAKEN = frozenset({
    *_UNIT_KEYS, "name", "address", "input_type", "data_type", "count", "swap", "structure", "unit_of_measurement",
    "scale", "offset", "nan_value", "min_value", "max_value", "scan_interval", "virtual_count", "slave_count",
    "zero_suppress",
})  # fmt: skip
"""What a sensor of Home Assistant is read by; of `zero_suppress` its own row speaks."""
_SHOWN = frozenset({"unique_id", "device_class", "state_class", "precision", "icon"})
"""How Home Assistant shows a value, which changes nothing of it."""
_CHANGES_NUMBERS = re.compile(
    r"(?:^|_)bits?(?:_|$)|mask|shift|(?:byte|word)_order|endian|factor|multipl|divi[ds]|negat|formula"
)
"""Keys of programs that write their lists as Home Assistant does, and more of them."""
_CHANGES_NOTHING = frozenset({"big", "big_endian", "be", "none", "false"})
_SWAPS = {"": "ABCD", "none": "ABCD", "byte": "BADC", "word": "CDAB", "word_byte": "DCBA"}
_BY_COUNT = {"1": "16", "2": "32", "4": "64"}
"""Home Assistant's older types, int, uint and float, have their registers beside them."""
_STRUCT = re.compile(r"([<>!=]?)\s*1?([hHlLiIqQfd])")
_OF_STRUCT = {"h": "int16", "H": "uint16", "i": "int32", "l": "int32", "I": "uint32", "L": "uint32"} | {
    "q": "int64", "Q": "uint64", "f": "float32", "d": "float64"
}  # fmt: skip
_DECODED = re.compile(r"(u?int|float)(16|32|64)(s?)(nan)?(s?)")
_READ_BY = {
    **{"holding": "holding", "input": "input", "coil": "coil", "discrete": "discrete", "discrete_input": "discrete"},
    **{"coils": "coil", "discreteinput": "discrete", "readholding": "holding", "readinput": "input"},
}
_ABSENT = {"uint16": "0xFFFF", "int16": "0x8000;0x7FFF", "uint32": "0xFFFFFFFF", "int32": "0x80000000;0x7FFFFFFF"} | {
    "uint64": str((1 << 64) - 1), "int64": str(-(1 << 63))
}  # fmt: skip
"""What evcc takes for no value, by a decode that ends in nan."""
_ACTION = re.compile(r"\{\{.*?\}\}")
_OWN = "OfTheTemplate"
"""What stands where a template puts something in."""
_STEPS = ("get", "set", "in", "source", "from", "to")
_COMPUTED = ("add", "sub", "mul", "div", "abs", "sign", "min", "max", "out")
_SCRIPTS = ("js", "go")
"""Sources that compute by a program of their own."""
_PART = "part"
_USAGE = re.compile(r'\s*eq\s+\.usage\s+"(\w+)"\s*')
_REGISTER_SOURCES = frozenset({"modbus", "sunspec"})
"""What evcc calls the sources that are read from registers."""


class TemplateError(OneLineError, ValueError):
    """The file is none of these lists, in words."""


@dataclass(frozen=True, slots=True)
class ListedUnit:
    """A row with the unit that it is of and its connection's name, "" where the list says none.

    `untaken` are keys of it that nothing is made of.
    """

    row: ListRow
    unit: str = ""
    hub: str = ""
    untaken: tuple[str, ...] = ()


@dataclass(slots=True)
class _Nodes:
    """A YAML document by its nodes: how many have been visited, and which mappings are being looked at."""

    visited: int = 0
    _open: set[int] = field(default_factory=set)

    def pairs(self, node: Any) -> list[tuple[str, Any, int]]:
        """(key, value, line) of a mapping, with what `<<` takes over; nothing for any other node."""
        found: list[tuple[str, Any, int]] = []
        if node is None or node.id != "mapping":
            return found
        for key, value in node.value:
            self.visited += 1
            if self.visited > MOST_NODES:
                raise TemplateError(f"has more than {MOST_NODES} nodes; give the part with the registers alone")
            if str(key.value) == "<<" and key.id == "scalar":
                parts = value.value if value.id == "sequence" else [value]
                if id(node) in self._open:
                    raise TemplateError(f"line {key.start_mark.line + 1}: takes itself over by <<; take that out")
                self._open.add(id(node))
                found = [pair for part in parts for pair in self.pairs(part)] + found
                self._open.discard(id(node))
            elif key.id == "scalar":
                found.append((str(key.value), value, key.start_mark.line + 1))
        return found

    def table(self, node: Any) -> dict[str, Any]:
        return {key: value for key, value, _ in self.pairs(node)}

    def items(self, node: Any) -> list[Any]:
        """The members of a list, or the one node in its place."""
        if node is None:
            return []
        members = node.value if node.id == "sequence" else [node]
        self.visited += len(members)
        return list(members)


def _scalar(node: Any) -> str:
    """A scalar's text; what is none has no text."""
    return str(node.value).strip() if node is not None and node.id == "scalar" else ""


def read_yaml(text: str, page: str | None) -> list[ListedUnit]:
    """The rows of a YAML list; `page` is the connection that is meant of several. Raises TemplateError."""
    root = _composed(text)
    nodes = _Nodes()
    table = nodes.table(root)
    if "render" in table:
        return [ListedUnit(row) for row in _of_evcc(table["render"])]
    hubs = table.get("modbus") or (root if root is not None and root.id == "sequence" else None)
    if hubs is None:
        hubs = next((inner for _, value, _ in nodes.pairs(root) if (inner := nodes.table(value).get("modbus"))), None)
    if hubs is None and {"sensors", "binary_sensors"} & set(table):
        hubs = root
    if hubs is None:
        raise TemplateError(
            "is no list that is known here: give a file with modbus: of Home Assistant, or a meter template of evcc"
        )
    rows = [row for hub in nodes.items(hubs) for row in _of_hub(nodes, hub)]
    names = list(dict.fromkeys(row.hub for row in rows))
    if page is not None and page not in names:
        raise TemplateError(f"has no connection {page!r}; it has {', '.join(map(repr, names)) or 'none'}")
    if page is None and len(names) > 1:
        raise TemplateError(f"has {len(names)} connections; say which with --sheet, one of {', '.join(names)}")
    return [row for row in rows if page in (None, row.hub)]


def _composed(text: str) -> Any:
    import yaml

    try:
        return yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark is not None else 1
        raise TemplateError(f"is no YAML: line {line}: {error.problem}; correct that line") from None
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise TemplateError(f"is no YAML ({' '.join(str(error).split())[:120]})") from None


# ---------------------------------------------------------------- Home Assistant


def _of_hub(nodes: _Nodes, hub: Any) -> Iterator[ListedUnit]:
    table = nodes.table(hub)
    name = _scalar(table.get("name"))
    for key, read in (("sensors", _sensor), ("binary_sensors", _binary_sensor)):
        for entity in nodes.items(table.get(key)):
            own = nodes.table(entity)
            unit = next((text for at in _UNIT_KEYS if (text := _scalar(own.get(at)))), "")
            line, untaken = entity.start_mark.line + 1, tuple(sorted(set(own) - _TAKEN - _SHOWN))
            changing = next((key for key in untaken if _may_change(key, _scalar(own[key]))), "")
            for cells in read(own):
                if changing and "refused" not in cells:
                    cells["refused"] = f"{changing} may change its number and is not read: give the row in a CSV list"
                yield ListedUnit(ListRow(line, {"order": "ABCD", "exact": "1", **cells}), unit, name, untaken)
                untaken = ()  # once for an entity that counts up further ones
    for key in _WRITTEN:
        for entity in nodes.items(table.get(key)):
            cells = {"name": _scalar(nodes.table(entity).get("name")) or key, "address": "-"}
            reason = f"is of {key}, which Home Assistant writes; a tag is read: give its register a row of its own"
            yield ListedUnit(ListRow(entity.start_mark.line + 1, cells | {"refused": reason}), "", name)


def _may_change(key: str, value: str) -> bool:
    return _CHANGES_NUMBERS.search(key) is not None and value.lower() not in _CHANGES_NOTHING


def _several(own: Mapping[str, Any], cells: Mapping[str, str], step: int) -> Iterator[dict[str, str]]:
    """The cells of an entity, and those of the further ones that it counts up."""
    further = _scalar(own.get("virtual_count")) or _scalar(own.get("slave_count")) or "0"
    if not further.isdecimal() or int(further) > 100 or "refused" in cells:
        yield {**cells} if further.isdecimal() else {**cells, "refused": f"virtual_count {further!r} is no number"}
        return
    table, _, number = cells["address"].partition(":")
    for place in range(int(further) + 1):
        name = cells["name"] if not place else f"{cells['name']} {place}"
        yield {**cells, "name": name, "address": f"{table}:{int(number) + place * step}"}


def _address(own: Mapping[str, Any], default: str) -> dict[str, str]:
    """The cells of name and address, or why there is none."""
    cells = {"name": _scalar(own.get("name")), "address": "-"}
    text, kind = _scalar(own.get("address")), _scalar(own.get("input_type")) or default
    try:
        number = int(text, 0)
    except ValueError:
        return cells | {"refused": f"address {text!r} is no number that stands in the list"}
    if kind not in _READ_BY:
        return cells | {"refused": f"input_type {kind!r} is none that is known here"}
    return cells | {"address": f"{_READ_BY[kind]}:{number}", "table": _READ_BY[kind]}


def _sensor(own: Mapping[str, Any]) -> Iterator[dict[str, str]]:
    cells = _address(own, "holding")
    texts = {key: _scalar(node) for key, node in own.items()}
    kind, count, swap = texts.get("data_type") or "int16", texts.get("count", ""), texts.get("swap", "").lower()
    refused = cells.get("refused", "")
    order = _SWAPS.get(swap.replace("false", ""), "")
    if not order:
        refused = refused or f"swap {swap!r} is none that is known here"
    if kind in ("int", "uint", "float"):
        kind += _BY_COUNT.get(count or ("2" if kind == "float" else "1"), "?")
    if kind == "custom":
        match = _STRUCT.fullmatch(texts.get("structure", ""))
        if match is None:
            refused = refused or f"structure {texts.get('structure', '')!r} is not one number in registers"
        else:
            kind = _OF_STRUCT[match[2]]
            # A structure of low bytes first reads all its registers backwards; without a sign it is as the host's own.
            backwards = {"ABCD": "DCBA", "DCBA": "ABCD", "CDAB": "BADC", "BADC": "CDAB"}
            order = backwards.get(order, "") if match[1] in ("", "=", "<") else order
            if _registers(kind) == "1" and order == "DCBA":
                order = "BADC"  # one register has no order of words
    if kind == "string":
        kind = f"STRING[{2 * int(count)}]" if count.isdecimal() else "string"
    elif count and not refused and _registers(kind) not in ("", count):
        refused = f"count {count} is not what a {kind} has"
    elif not _registers(kind):
        refused = refused or f"data_type {kind!r} is none that is known here"
    cells |= {"dtype": kind, "order": order, "unit": texts.get("unit_of_measurement", "")}
    cells |= {
        "scale": texts.get("scale", ""),
        "offset": texts.get("offset", ""),
        "sentinel": texts.get("nan_value", ""),
        "low": texts.get("min_value", ""),
        "high": texts.get("max_value", ""),
        "period": texts.get("scan_interval", ""),
    }
    if _number(cells["period"]) == 0:
        cells["period"] = ""  # read on demand alone
    if refused:
        cells["refused"] = refused
    if texts.get("zero_suppress"):
        cells["said"] = f"zero_suppress {texts['zero_suppress']} is not taken"
    yield from _several(own, cells, int(_registers(kind) or "1") if not kind.startswith("STRING") else int(count))


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _registers(kind: str) -> str:
    """How many registers a numeric type has, as text; "" for none that is known."""
    match = re.fullmatch(r"(?:u?int)(16|32|64)|float(32|64)", kind)
    return str(int(match[1] or match[2]) // 16) if match else ""


def _binary_sensor(own: Mapping[str, Any]) -> Iterator[dict[str, str]]:
    cells = _address(own, "coil")
    cells |= {"dtype": "bool", "period": _scalar(own.get("scan_interval"))}
    if _number(cells["period"]) == 0:
        cells["period"] = ""
    if cells.get("table") in ("holding", "input"):
        cells["bit"] = "0"  # Home Assistant looks at the lowest one
    yield from _several(own, cells, 1)


# ---------------------------------------------------------------- evcc


@dataclass(slots=True)
class _Rendered:
    """A template's text without its actions: line by line what it says, and under which conditions."""

    lines: list[str] = field(default_factory=list)
    under: list[tuple[str, ...]] = field(default_factory=list)


def _without_actions(text: str) -> _Rendered:
    """The YAML of a template: its actions are taken out, what they put in is marked, conditions are noted by line."""
    rendered, stack = _Rendered(), list[str]()
    for line in text.split("\n"):
        before = tuple(stack)
        for action in _ACTION.findall(line):
            words = action.strip("{}").strip("- ").strip()
            if words.startswith(("if ", "with ", "range ")):
                stack.append(words.partition(" ")[2])
            elif words.startswith("else"):
                last = stack.pop() if stack else ""
                also = words.removeprefix("else").strip().removeprefix("if").strip()
                stack.append(also or f"not ({last})")
            elif words == "end" and stack:
                stack.pop()
        rest = _ACTION.sub("", line)
        alone = not rest.strip(" -")
        plain = "" if alone and rest != line else _ACTION.sub(_OWN, line)
        rendered.lines.append(plain)
        rendered.under.append(tuple(stack) if not alone else before)
    return rendered


def _of_evcc(render: Any) -> Iterator[ListRow]:
    first = render.start_mark.line + (2 if getattr(render, "style", "") in ("|", ">") else 1)
    rendered = _without_actions(_scalar_text(render))
    root = _composed("\n".join(rendered.lines))
    nodes, names = _Nodes(), dict[str, int]()
    for path, source, script in _sources(nodes, root, (), 0):
        line = source.start_mark.line
        cells = _evcc_cells(nodes, source, rendered)
        usage = next((match[1] for text in rendered.under[line] if (match := _USAGE.fullmatch(text))), "")
        name = "_".join(part for part in (usage, *path) if part) or "value"
        names[name] = names.get(name, 0) + 1
        if names[name] > 1:
            name = f"{name}_{names[name]}"
        where = [text for text in rendered.under[line] if not _USAGE.fullmatch(text)]
        said = [f"where {' and '.join(where)}"] if where else []
        said += ["a part of what evcc computes"] if any(part.startswith(_PART) for part in path) else []
        cells["said"] = "; ".join(said)
        if script:
            cells = {"refused": f"is a part of what evcc computes (source: {script}); give its row by hand", **cells}
        yield ListRow(first + line, {"name": name, "order": "ABCD", "exact": "1", **cells})


def _scalar_text(node: Any) -> str:
    return str(node.value) if node is not None and node.id == "scalar" else ""


def _sources(
    nodes: _Nodes, node: Any, path: tuple[str, ...], depth: int, script: str = ""
) -> Iterator[tuple[tuple[str, ...], Any, str]]:
    """Every mapping with `source: modbus`, with the names on the way to it and the script that computes with it."""
    if node is None or depth > _MOST_DEPTH:
        return
    if node.id == "mapping":
        source = _scalar(nodes.table(node).get("source"))
        if source in _REGISTER_SOURCES:
            yield path, node, script
            return
        script = source if source in _SCRIPTS else script
        for key, value, _ in nodes.pairs(node):
            way = (*path, _PART) if key in _COMPUTED else path if key in _STEPS else (*path, key)
            yield from _sources(nodes, value, way, depth + 1, script)
    elif node.id == "sequence":
        way = path or ("value",)
        for place, member in enumerate(nodes.items(node), start=1):
            yield from _sources(nodes, member, (*way[:-1], f"{way[-1]}{place}"), depth + 1, script)


def _evcc_cells(nodes: _Nodes, source: Any, rendered: _Rendered) -> dict[str, str]:
    """The cells of one source of a template."""
    own = nodes.table(source)
    register = nodes.table(own.get("register"))
    cells = {"address": "-"}
    if "register" not in own:
        named = _scalar(own.get("value"))
        return cells | {"refused": f"names {named!r} of a device or a SunSpec model, and no register"}
    home = rendered.under[source.start_mark.line]
    lines = [line - 1 for _, _, line in (*nodes.pairs(source), *nodes.pairs(own["register"]))]
    if bound := next((rendered.under[line] for line in lines if rendered.under[line] != home), None):
        return cells | {"refused": f"hangs on a setting of the template, {bound[-1]!r}: give its row by hand"}
    texts = {key: _scalar(register.get(key)) for key in register}
    kind = texts.get("type", "").lower()
    if kind.startswith("write"):
        return cells | {"refused": f"is written ({kind}), and a tag is read"}
    if kind not in _READ_BY:
        return cells | {"refused": f"type {kind!r} is none that is known here"}
    scale = _scalar(own.get("scale"))
    for what, text in (("address", texts.get("address", "")), ("scale", scale), ("decode", texts.get("decode", ""))):
        if _OWN in text:
            return cells | {"refused": f"its {what} hangs on a setting of the template: give its row by hand"}
    try:
        number = int(texts.get("address", ""), 0)
    except ValueError:
        return cells | {"refused": f"address {texts.get('address', '')!r} is no number"}
    cells = {"address": f"{_READ_BY[kind]}:{number}", "table": _READ_BY[kind], "scale": scale}
    if more := [key for key in texts if key not in ("address", "type", "decode", "encoding", "length", "count")]:
        return cells | {"refused": f"has {more[0]!r}, which is not known here"}
    decoded = (texts.get("decode") or texts.get("encoding") or "").lower()
    if cells["table"] in ("coil", "discrete") or decoded in ("bool8", "bool16"):
        return cells | {"dtype": "bool", "scale": ""}
    match = _DECODED.fullmatch(decoded)
    if match is None or (match[1], match[2]) == ("float", "16"):
        return cells | {"refused": f"decode {decoded!r} is no number that is known here"}
    dtype = match[1] + match[2]
    order = "CDAB" if match[3] or match[5] else "ABCD"
    return cells | {"dtype": dtype, "order": order, "sentinel": _ABSENT.get(dtype, "") if match[4] else ""}
