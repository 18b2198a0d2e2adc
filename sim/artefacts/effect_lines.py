"""Engineers' own effects as text: the entries of a TOML file of effects, and the same entries inside a model's JSON."""

import tomllib
from collections.abc import Sequence
from math import inf, isfinite
from pathlib import Path
from typing import Any

from drivers.named_files import MOST_TOML_BYTES, contents, parse_toml
from sim.artefacts.json_node import JsonNode, written_number
from sim.effects import LineError, own_kind
from sim.files import ArtefactError, file_error
from sim.sha import EffectLine, LineActs, LineParameter

ACTS: dict[str, LineActs] = {"running": "running", "anywhere": "anywhere"}
LINE_KEYS = ("name", "meaning", "heat", "acts", "strength", "signals", "parameters", "experiment", "look")
DEFAULT_STRENGTH = "gain"
MAX_EFFECTS = 50
"""Effects of one file at most: each is a hypothesis more that the data must pay for."""


def read_effect_lines(path: Path) -> tuple[EffectLine, ...]:
    """The effects of a TOML file. Raises ArtefactError with file, key, reason, and what would be right; OSError."""
    try:
        document = parse_toml(contents(path, MOST_TOML_BYTES).decode("utf-8"))
    except UnicodeDecodeError:
        raise file_error(path, None, "is no UTF-8 text; save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise file_error(path, None, f"is no TOML: {error}; correct that place") from None
    nodes = list(JsonNode(document, path).require_keys(("effect",)).get("effect").each())
    if not 0 < len(nodes) <= MAX_EFFECTS:
        raise file_error(
            path, None, f"effect: has {len(nodes)} entries; give 1 to {MAX_EFFECTS}, each under [[effect]]"
        )
    lines = tuple(read_effect_line(node) for node in nodes)
    for number, line in enumerate(lines):
        if line.name in [other.name for other in lines[:number]]:
            raise nodes[number].get("name").error(f"{line.name!r} stands there twice; give one of them another name")
    return lines


def read_embedded_line(value: Any, file: Path, path: str) -> EffectLine:
    """The line of an entry that stands at a key path of somebody else's document. Raises ArtefactError."""
    return read_effect_line(JsonNode(value, file, path))


def read_effect_line(node: JsonNode) -> EffectLine:
    """The line of an entry, checked as a whole. Raises ArtefactError with the key that is wrong."""
    table = node.require_keys(LINE_KEYS).value
    acts = node.get("acts").text() if "acts" in table else "running"
    if acts not in ACTS:
        raise node.get("acts").error(f"{acts!r} is unknown; give 'running' (while the machine runs) or 'anywhere'")
    line = EffectLine(
        name=node.get("name").text(),
        heat=node.get("heat").text(),
        meaning=node.get("meaning").text(),
        strength=node.get("strength").text() if "strength" in table else DEFAULT_STRENGTH,
        experiment=node.get("experiment").text(),
        look=node.get("look").text() if "look" in table else "",
        acts=ACTS[acts],
        signals=tuple(node.get("signals").table(JsonNode.text).items()) if "signals" in table else (),
        parameters=tuple(
            _read_parameter(name, node.get("parameters").get(name))
            for name in node.get("parameters").table(lambda each: each)
        ),
    )
    try:
        own_kind(line)
    except LineError as error:
        raise _at_key(node, error.key).error(error.sentence) from None
    return line


def _at_key(node: JsonNode, key: str) -> JsonNode:
    """The entry's value of a dotted key; the entry itself where that is not given."""
    for part in key.split("."):
        if not isinstance(node.value, dict) or part not in node.value:
            return JsonNode(None, node.file, f"{node.path}.{key}")
        node = node.get(part)
    return node


def _read_parameter(name: str, node: JsonNode) -> LineParameter:
    table = node.require_keys(("unit", "low", "high", "try", "usual")).value
    return LineParameter(
        name=name,
        unit=node.get("unit").text(),
        low=node.get("low").number() if "low" in table else -inf,
        high=node.get("high").number() if "high" in table else inf,
        tried=tuple(each.number() for each in node.get("try").each()) if "try" in table else (),
        usual=node.get("usual").text() if "usual" in table else "",
    )


def effect_line_part(line: EffectLine) -> dict[str, Any]:
    """The entry of a line, as `read_effect_line` reads it; what is not given is left out."""
    return {
        "name": line.name,
        "meaning": line.meaning,
        "heat": line.heat,
        "acts": line.acts,
        "strength": line.strength,
        "experiment": line.experiment,
        **({"look": line.look} if line.look else {}),
        **({"signals": dict(line.signals)} if line.signals else {}),
        "parameters": {each.name: _parameter_part(each) for each in line.parameters},
    }


def _parameter_part(each: LineParameter) -> dict[str, Any]:
    ends = {"low": each.low, "high": each.high}
    return {
        "unit": each.unit,
        **{end: written_number(value) for end, value in ends.items() if isfinite(value)},
        **({"try": [written_number(value) for value in each.tried]} if each.tried else {}),
        **({"usual": each.usual} if each.usual else {}),
    }


def effect_lines_text(lines: Sequence[EffectLine]) -> str:
    """The TOML file of effects. Raises ArtefactError for a line that could not be read back."""
    import tomlkit

    document = tomlkit.document()
    entries = tomlkit.aot()
    for line in lines:
        part = effect_line_part(line)
        entry = tomlkit.table()
        for key, value in part.items():
            if key == "parameters":
                table = tomlkit.table()
                for name, numbers in value.items():
                    inline = tomlkit.inline_table()
                    inline.update(numbers)
                    table[name] = inline
                value = table
            entry[key] = value
        entries.append(entry)
    document["effect"] = entries
    text = tomlkit.dumps(document)
    read_back = JsonNode(parse_toml(text), "the written effects")
    if tuple(read_effect_line(node) for node in read_back.get("effect").each()) != tuple(lines):
        raise ArtefactError("the effects cannot be written: they would not be read back as they are")
    return text
