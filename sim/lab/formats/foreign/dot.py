"""`<NAME>_source.txt`: the automaton's structure as DOT, in the form that the public L*_SHA learner writes.

The DOT language is parsed by its own grammar (https://graphviz.org/doc/info/lang.html) and the labels, which are
HTML-like fragments, by an HTML parser. What the parts mean is said by their colours: a location's `f_1, D_0` (flow and
distribution) is #ad0c00, an edge's event #0067b0 and its optional guard #008c05. The node `__init__` is where a trace
starts; its edges carry the first event of a trace and there may be several.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from html import escape
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

from lark import Lark, Token, Tree

from sim.files import ArtefactError, file_error, read_text
from sim.lab.formats.foreign.grammar import parse_text, subtrees, trees
from sim.sha import Edge

INIT = "__init__"
NAME_COLOUR, MODE_COLOUR, SYMBOL_COLOUR, GUARD_COLOUR = "black", "#ad0c00", "#0067b0", "#008c05"
UNOBSERVED_LABEL = "ε"

GRAMMAR = r"""
start: STRICT? DIGRAPH id? "{" _statement* "}"
_statement: (node | edge | default | assignment | subgraph) ";"?
node: node_id attributes*
edge: node_id ("->" node_id)+ attributes*
default: (GRAPH | NODE | EDGE) attributes+
assignment: id "=" id
subgraph: (SUBGRAPH id?)? "{" _statement* "}"
node_id: id (":" id (":" id)?)?
attributes: "[" (attribute ("," | ";")?)* "]"
attribute: id ("=" id)?
id: NAME | NUMERAL | HTML | STRING ("+" STRING)*

STRICT: "strict"i
DIGRAPH: "digraph"i
GRAPH: "graph"i
NODE: "node"i
EDGE: "edge"i
SUBGRAPH: "subgraph"i
NAME: /[^\W\d]\w*/i
NUMERAL: /-?(?:\.\d+|\d+(?:\.\d*)?)/
STRING: /"(?:[^"\\]|\\.)*"/s
HTML: /<(?:[^<>]|<[^<>]*>)*>/
COMMENT: /\/\/[^\n]*|\/\*(?:.|\n)*?\*\/|#[^\n]*/
%ignore COMMENT
%ignore /[ \t\f\r\n]+/
"""
EXPECTED_TEXT = "the file must be DOT: digraph NAME { a [label=<...>]  a -> b [label=<...>] }"
HEADER_LINES = (
    "edge [arrowsize=0.5]",
    "rankdir=LR size=2",
    "node [shape=circle]",
    "node [fontname=helvetica]",
    "node [penwidth=0.5]",
    "edge [fontname=helvetica]",
    "edge [penwidth=0.5]",
)


@dataclass(frozen=True, slots=True)
class SourceLocation:
    """A node: its flow's number in `flow_conditions.txt` and its distribution's name in the report, if any."""

    name: str
    flow: int | None = None
    distribution: str | None = None


@dataclass(frozen=True, slots=True)
class Source:
    """The graph in the file's order. Edges from `__init__` may have an empty symbol (the start, before any event)."""

    locations: tuple[SourceLocation, ...]
    edges: tuple[Edge, ...]
    graph: str = "hybrid_automaton"


@cache
def _parser() -> Lark:
    return Lark(GRAMMAR, parser="lalr", propagate_positions=True)


def read_source(path: Path) -> Source:
    """The automaton's structure. Raises ArtefactError with file and line."""
    return parse_source(read_text(path), path)


def parse_source(text: str, file: str | Path = "source") -> Source:
    """As `read_source`, from the text itself; `file` is the name for messages."""
    tree = parse_text(_parser(), text, file, EXPECTED_TEXT)
    title = next((_text(child) for child in trees(tree, "id")), "")
    locations: dict[str, SourceLocation] = {}
    for node in subtrees(tree, "node"):
        name = _node_name(trees(node, "node_id")[0])
        modes = [text for text, colour in runs(_label(node)) if colour == MODE_COLOUR]
        location = SourceLocation(name)
        if modes:
            match = re.fullmatch(rf"(?:f_(\d+)|{UNOBSERVED_LABEL})\s*,\s*([A-Z]_\d+|{UNOBSERVED_LABEL})", modes[0])
            if match is None or len(modes) > 1:
                wanted = "one flow and one distribution are needed, like 'f_1, D_0'"
                raise file_error(file, node.meta.line, f"location {name!r} is labelled {' '.join(modes)!r}; {wanted}")
            flow, distribution = match.groups()
            location = SourceLocation(
                name, None if flow is None else int(flow), None if distribution == UNOBSERVED_LABEL else distribution
            )
        if name in locations:
            raise file_error(file, node.meta.line, f"location {name!r} stands here a second time; keep one")
        locations[name] = location
    # After all nodes, wherever they stand: DOT lets an edge come before the nodes that it joins.
    edges = tuple(edge for node in subtrees(tree, "edge") for edge in _edges(node, locations, file))
    return Source(tuple(locations.values()), edges, title)


def _text(identifier: Tree[Token]) -> str:
    """An identifier's characters: quotes taken off and concatenated strings joined; HTML keeps its angle brackets."""
    parts = [str(token) for token in identifier.children]
    if not parts[0].startswith('"'):
        return parts[0]
    return "".join(re.sub(r'\\(")|\\\n', r"\1", part[1:-1]) for part in parts)


def _label(statement: Tree[Token]) -> str:
    """The statement's label as written, "" without one. The last one counts, as in Graphviz."""
    label = ""
    for attributes in trees(statement, "attributes"):
        for attribute in trees(attributes, "attribute"):
            name, *value = (_text(child) for child in trees(attribute, "id"))
            if name.lower() == "label" and value:
                label = value[0]
    return label


def _node_name(node_id: Tree[Token]) -> str:
    return _text(trees(node_id, "id")[0])


def _edges(node: Tree[Token], locations: dict[str, SourceLocation], file: str | Path) -> Iterator[Edge]:
    line = node.meta.line
    ends = [_node_name(end) for end in trees(node, "node_id")]
    for end in ends:
        if end not in locations:
            raise file_error(
                file, line, f"the edge {' -> '.join(ends)} leads to {end!r}, which is not defined; add the node"
            )
    # By colour where the colours are known; else the last text is the symbol and the one before it the guard.
    parts = runs(_label(node))
    guard = next((text for text, colour in parts if colour == GUARD_COLOUR), None)
    symbol = next((text for text, colour in parts if colour == SYMBOL_COLOUR), None)
    if symbol is None and guard is None and parts:
        symbol = parts[-1][0]
        guard = parts[-2][0] if len(parts) > 1 else None
    symbol = symbol or ""
    if not symbol and ends[0] != INIT:
        raise file_error(
            file, line, f"the edge {' -> '.join(ends)} has no event; give it a label with the event's symbol"
        )
    for source, target in pairwise(ends):
        yield Edge(source, symbol, target, guard)


class _Runs(HTMLParser):
    """Collects the texts of an HTML-like label with the colour of the innermost FONT around each."""

    def __init__(self) -> None:
        super().__init__()
        self.colours = [""]
        self.texts: list[tuple[str, str]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "font":
            self.colours.append((dict(attrs).get("color") or self.colours[-1]).lower())

    def handle_endtag(self, tag: str) -> None:
        if tag == "font" and len(self.colours) > 1:
            self.colours.pop()

    def handle_data(self, data: str) -> None:
        if data.strip():
            self.texts.append((data.strip(), self.colours[-1]))


def runs(label: str) -> list[tuple[str, str]]:
    """The texts of a label with their colours, in order; a plain label is one text without colour."""
    if not label.startswith("<"):
        return [(label.strip(), "")] if label.strip() else []
    reader = _Runs()
    reader.feed(label[1:-1])
    reader.close()
    return reader.texts


def source_text(source: Source) -> str:
    """The DOT text, byte for byte as the public learner writes it. Raises ArtefactError for unusable names."""
    lines = [f"digraph {_quote_name(source.graph)} {{" if source.graph else "digraph {"]
    lines += [f"\t{line}" for line in HEADER_LINES]
    for location in source.locations:
        parts = [_font(_plain(location.name), 8, NAME_COLOUR)]
        if location.flow is not None or location.distribution is not None:
            flow = UNOBSERVED_LABEL if location.flow is None else f"f_{location.flow}"
            mode = f"<br/><b>{flow}, {location.distribution or UNOBSERVED_LABEL}</b>"
            parts.append(_font(mode, 6, MODE_COLOUR))
        lines.append(f"\t{_quote_name(location.name)} [label=<{'<br/>'.join(parts)}>]")
    for edge in source.edges:
        parts = [_font(_plain(edge.guard), 8, GUARD_COLOUR)] if edge.guard else []
        parts += [_font(_plain(edge.symbol), 8, SYMBOL_COLOUR)] if edge.symbol else []
        label = f"<{'<br/>'.join(parts)}>" if parts else '""'
        lines.append(f"\t{_quote_name(edge.source)} -> {_quote_name(edge.target)} [label={label}]")
    return "\n".join([*lines, "}", ""])


def _quote_name(name: str) -> str:
    if re.fullmatch(r"[a-zA-Z_]\w*", name, re.ASCII) and name.lower() not in (
        "strict",
        "digraph",
        "graph",
        "node",
        "edge",
        "subgraph",
    ):
        return name
    if not name or "\\" in name or "\n" in name:
        raise ArtefactError(f"{name!r} cannot be a name in DOT; use letters, digits and blanks")
    return '"' + name.replace('"', '\\"') + '"'


def _font(text: str, size: int, colour: str) -> str:
    return f'<FONT  POINT-SIZE="{size}" COLOR="{colour}">{text}</FONT>'


def _plain(text: str) -> str:
    if text != text.strip() or "\n" in text:
        raise ArtefactError(f"the label {text!r} would lose its blanks; use a text without blanks at its ends")
    return escape(text, quote=False)
