"""A small interpreter of exported documents, written from UPPAAL's language and not from the exporter.

It reads the XML text, evaluates its declarations, guards, rates and updates by a grammar of its own, and lets the
network run: committed locations first, then as much time as the invariants allow, rates integrated by Runge-Kutta.
Many runs at once are arrays; which edges fire must be the same in all of them.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any
from xml.etree import ElementTree

import numpy as np
from lark import Lark, Token, Transformer

GRAMMAR = r"""
?start: updates | disjunction
updates: assignment ("," assignment)*
assignment: NAME "=" ternary
?ternary: disjunction | disjunction "?" ternary ":" ternary -> choice
?disjunction: conjunction | disjunction "||" conjunction -> either
?conjunction: relation | conjunction "&&" relation -> both
?relation: sum | sum RELATION sum -> compare
?sum: product | sum "+" product -> add | sum "-" product -> subtract
?product: unary | product "*" unary -> multiply | product "/" unary -> divide
?unary: atom | "-" unary -> negate
?atom: NUMBER -> literal
     | NAME "(" ternary ("," ternary)* ")" -> call
     | NAME "[" ternary "]" -> element
     | NAME "'" -> rate
     | NAME -> name
     | "(" ternary ")"
RELATION: "<=" | ">=" | "==" | "<" | ">"
NUMBER: /\d+(\.\d+)?([eE][+-]?\d+)?/
NAME: /[A-Za-z_]\w*/
%ignore " "
"""
SLACK = 1e-9
Env = dict[str, Any]
Code = Callable[[Env], Any]
FUNCTIONS: dict[str, Callable[..., Any]] = {
    "fmin": np.minimum, "fmax": np.maximum, "sqrt": np.sqrt, "exp": np.exp, "ln": np.log, "pow": np.power,
}  # fmt: skip
RELATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "<=": lambda a, b: a <= b + SLACK,
    ">=": lambda a, b: a >= b - SLACK,
    "==": lambda a, b: a == b,
    "<": lambda a, b: a < b,
    ">": lambda a, b: a > b,
}


class Compiler(Transformer[Token, Code]):
    """Text to closures over an environment of names."""

    def literal(self, parts: list[Any]) -> Code:
        value = float(parts[0]) if re.search("[.eE]", parts[0]) else int(parts[0])
        return lambda env: value

    def name(self, parts: list[Any]) -> Code:
        word = str(parts[0])
        return lambda env: env[word]

    def rate(self, parts: list[Any]) -> Code:
        raise AssertionError("a rate is read by its invariant, not evaluated")

    def element(self, parts: list[Any]) -> Code:
        word, index = str(parts[0]), parts[1]
        return lambda env: env[word][index(env)]

    def call(self, parts: list[Any]) -> Code:
        word, arguments = str(parts[0]), parts[1:]
        if word.startswith("random"):
            return lambda env: env["#draw"](word, *(one(env) for one in arguments))
        function = FUNCTIONS[word]
        return lambda env: function(*(one(env) for one in arguments))

    def choice(self, parts: list[Any]) -> Code:
        def chosen(env: Env) -> Any:
            with np.errstate(divide="ignore", invalid="ignore"):  # the part that is not taken is worked out too
                return np.where(parts[0](env), parts[1](env), parts[2](env))

        return chosen

    def either(self, parts: list[Any]) -> Code:
        return lambda env: np.logical_or(parts[0](env), parts[1](env))

    def both(self, parts: list[Any]) -> Code:
        return lambda env: np.logical_and(parts[0](env), parts[1](env))

    def compare(self, parts: list[Any]) -> Code:
        relation = RELATIONS[str(parts[1])]
        return lambda env: relation(parts[0](env), parts[2](env))

    def add(self, parts: list[Any]) -> Code:
        return lambda env: parts[0](env) + parts[1](env)

    def subtract(self, parts: list[Any]) -> Code:
        return lambda env: parts[0](env) - parts[1](env)

    def multiply(self, parts: list[Any]) -> Code:
        return lambda env: parts[0](env) * parts[1](env)

    def divide(self, parts: list[Any]) -> Code:
        return lambda env: parts[0](env) / parts[1](env)

    def negate(self, parts: list[Any]) -> Code:
        return lambda env: -parts[0](env)

    def assignment(self, parts: list[Any]) -> tuple[str, Code]:
        return str(parts[0]), parts[1]

    def updates(self, parts: list[Any]) -> list[tuple[str, Code]]:
        return parts


def parsed(xml: str) -> ElementTree.Element:
    """The root of a document."""
    parser = ElementTree.XMLParser()
    parser.feed(xml)
    root = parser.close()
    assert isinstance(root, ElementTree.Element)
    return root


@cache
def grammar() -> Lark:
    return Lark(GRAMMAR, parser="lalr")


@cache
def code(text: str) -> Any:
    return Compiler().transform(grammar().parse(text))


@dataclass
class Edge:
    source: str
    target: str
    guard: str
    sync: str
    update: str


@dataclass
class Process:
    """An instance: where it is, its own names, its edges, invariants and kinds of location."""

    name: str
    here: str
    own: Env
    clocks: list[str]
    edges: list[Edge]
    invariants: dict[str, str]
    kinds: dict[str, str]
    fired: list[tuple[float, str]] = field(default_factory=list)
    leaving: dict[str, list[Edge]] = field(init=False)

    def __post_init__(self) -> None:
        """The edges by where they begin, in the document's order: the 102 symbols of a spindle make 10,302 of them."""
        self.leaving = {place: [] for place in self.kinds}
        for edge in self.edges:
            self.leaving[edge.source].append(edge)


def declarations(text: str, known: Env) -> tuple[Env, list[str]]:
    """Names with their values, and the clocks among them."""
    env: Env = {}
    clocks: list[str] = []
    bare = re.sub(r"//[^\n]*", "", text)
    for statement in filter(None, (one.strip() for one in bare.split(";"))):
        words = re.match(r"(?:const |hybrid |broadcast )?(int|double|clock|chan) +(.*)", statement, re.DOTALL)
        assert words, statement
        kind, rest = words[1], words[2]
        if kind == "chan":
            continue
        if array := re.fullmatch(r"(\w+)\[(\d+)\] *= *\{(.*)\}", rest, re.DOTALL):
            values = [float(part) if kind == "double" else int(part) for part in array[3].split(",")]
            assert len(values) == int(array[2])
            env[array[1]] = values
            continue
        for part in rest.split(","):
            name, _, value = (piece.strip() for piece in part.partition("="))
            sign, number = (-1, value[1:]) if value.startswith("-") else (1, value)
            env[name] = sign * code(number)({**known, **env}) if value else 0.0
            clocks += [name] if kind == "clock" else []
    return env, clocks


class Network:
    """A document ready to run; `draw(function, *arguments)` answers the random functions."""

    def __init__(self, xml: str, draw: Callable[..., Any]) -> None:
        root = parsed(xml)
        self.now = 0.0
        self.globals, _ = declarations(root.findtext("declaration") or "", {})
        self.globals["#draw"] = draw
        templates = {template.findtext("name"): template for template in root.iterfind("template")}
        system = re.sub(r"//[^\n]*", "", root.findtext("system") or "")
        self.processes = [
            self._process(name, templates[template]) for name, template in re.findall(r"(\w+) = (\w+)\(\);", system)
        ]
        self.by_name = {process.name: process for process in self.processes}
        text = root.findtext("declaration") or ""
        self.broadcast = set(re.findall(r"broadcast chan (\w+)", text))

    def _process(self, name: str, template: ElementTree.Element) -> Process:
        names = {one.get("id"): one.findtext("name") or "" for one in template.iterfind("location")}
        invariants, kinds = {}, {}
        for one in template.iterfind("location"):
            place = one.findtext("name") or ""
            invariants[place] = next((x.text or "" for x in one.iterfind("label") if x.get("kind") == "invariant"), "")
            kinds[place] = next((kind for kind in ("committed", "urgent") if one.find(kind) is not None), "")
        edges = []
        for one in template.iterfind("transition"):
            texts = {label.get("kind"): label.text or "" for label in one.iterfind("label")}
            ends = [names[found.get("ref")] for end in ("source", "target") if (found := one.find(end)) is not None]
            parts = (texts.get(kind, "") for kind in ("guard", "synchronisation", "assignment"))
            edges.append(Edge(ends[0], ends[1], *parts))
        own, clocks = declarations(template.findtext("declaration") or "", self.globals)
        start = template.find("init")
        assert start is not None
        return Process(name, names[start.get("ref")], own, clocks, edges, invariants, kinds)

    def env(self, process: Process) -> Env:
        return {**self.globals, **process.own}

    def _holds(self, process: Process, edge: Edge) -> bool:
        if not edge.guard:
            return True
        held = code(edge.guard)(self.env(process))
        if not np.ndim(held):
            return bool(held)
        number = np.count_nonzero(held)
        assert number in (0, held.size), "the runs part ways"
        return bool(number)

    def _apply(self, process: Process, edge: Edge) -> None:
        if edge.update:
            for name, value in code(edge.update):
                place = process.own if name in process.own else self.globals
                place[name] = value(self.env(process))
        process.here = edge.target
        process.fired.append((self.now, edge.sync))

    def _fire(self, process: Process, edge: Edge) -> bool:
        """Takes an edge, with its receivers; False where a binary partner is missing."""
        channel = edge.sync[:-1]
        receivers = [
            (other, one)
            for other in self.processes
            if edge.sync.endswith("!") and other is not process
            for one in other.leaving[other.here]
            if one.sync == f"{channel}?" and self._holds(other, one)
        ]
        if edge.sync.endswith("!") and channel not in self.broadcast and not receivers:
            return False
        assert len({id(other) for other, _ in receivers}) == len(receivers), "a receiver has a choice"
        self._apply(process, edge)
        for other, one in receivers:
            self._apply(other, one)
        return True

    def step(self) -> bool:
        """Takes one edge that may be taken now; committed locations come first."""
        committed = [process for process in self.processes if process.kinds[process.here] == "committed"]
        for process in committed or self.processes:
            for edge in process.leaving[process.here]:
                if not edge.sync.endswith("?") and self._holds(process, edge) and self._fire(process, edge):
                    return True
        return False

    def settle(self) -> None:
        for _ in range(10_000):
            if not self.step():
                return
        raise AssertionError("time stands still")

    def allowed(self) -> float:
        """The longest delay that every invariant allows."""
        delays = [np.inf]
        for process in self.processes:
            if process.kinds[process.here] in ("committed", "urgent"):
                delays.append(0.0)
            for part in process.invariants[process.here].split(" && "):
                if bound := re.fullmatch(r"(\w+) <= (.+)", part):
                    delays.append(float(code(bound[2])(self.env(process)) - process.own[bound[1]]))
        return max(0.0, min(delays))

    def pass_time(self, delay: float, most: float) -> None:
        """Advances all clocks; those with a rate of their own by Runge-Kutta steps of at most `most` seconds."""
        for process in self.processes:
            parts = process.invariants[process.here].split(" && ")
            rates = dict(found.groups() for part in parts if (found := re.fullmatch(r"(\w+)' == (.+)", part)))
            steps = max(1, int(np.ceil(delay / most))) if rates else 1
            for _ in range(steps):
                self._advance(process, rates, delay / steps)
        self.now += delay

    def _advance(self, process: Process, rates: dict[str, str], h: float) -> None:
        plain = [clock for clock in process.clocks if clock not in rates]
        before = {name: process.own[name] for name in process.clocks}
        slopes: list[dict[str, Any]] = []
        env = self.env(process)
        for share in (0.0, 0.5, 0.5, 1.0):
            for name in plain:
                env[name] = before[name] + share * h
            for name in rates:
                env[name] = before[name] + (share * h * slopes[-1][name] if slopes else 0.0)
            slopes.append({name: code(text)(env) for name, text in rates.items()})
        for name in plain:
            process.own[name] = before[name] + h
        for name in rates:
            k1, k2, k3, k4 = (slope[name] for slope in slopes)
            process.own[name] = before[name] + h * (k1 + 2 * k2 + 2 * k3 + k4) / 6

    def run(self, until: float, watch: Callable[["Network"], None] | None = None, most: float = 0.25) -> None:
        """Runs to the time `until`; `watch` is called whenever nothing more happens at an instant."""
        while True:
            self.settle()
            if watch:
                watch(self)
            left = until - self.now
            delay = min(self.allowed(), left)
            if delay <= 0 and left <= SLACK:
                return
            assert delay > 0, f"no time may pass at {self.now} s, and no edge may be taken"
            self.pass_time(delay, most)
