"""The rules that UPPAAL's parser and engine hold an exported document to, checked on the emitted text."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree.ElementTree import Element, ParseError, XMLParser

from sim.lab.checking.query import FUNCTIONS, KEYWORDS

_DOCTYPE = re.compile(
    r"<!DOCTYPE nta PUBLIC '-//Uppaal Team//DTD Flat System 1\.(\d)//EN' "
    r"'http://www\.it\.uu\.se/research/group/darts/uppaal/flat-1_\1\.dtd'>"
)
_NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
_NUMBER = re.compile(r"(?<![\w.])(?:\d+\.\d*|\d+|\.\d+)(?:[eE][+-]?\d+)?(?![\w.])")
_DECLARED = re.compile(r"\b(?:const\s+)?(?:hybrid\s+|broadcast\s+|urgent\s+)*(?:int|double|bool|clock|chan)\b([^;]*);")
_SYMBOLIC = re.compile(r"^\s*(?:[AE]\s*(?:<>|\[\])|.*-->(?!\s*\[))")
_STATISTICAL = re.compile(r"\b(?:Pr|simulate)\b|\bE\s*\[\s*(?:<=|#)")
LABELS = ("guard", "synchronisation", "assignment", "invariant")


@dataclass(frozen=True, slots=True)
class _Label:
    """One text of the document: the template it is in (empty for the global declarations) and its kind."""

    template: str
    kind: str
    text: str

    def place(self) -> str:
        return f"{self.template or 'global'} {self.kind} {self.text[:60]!r}"


@dataclass(frozen=True, slots=True)
class _ParsedDocument:
    """A parsed document: all labels and declarations without their comments, and the names that are declared."""

    root: Element
    labels: tuple[_Label, ...]
    declarations: tuple[_Label, ...]
    declared: dict[str, frozenset[str]]
    locations: dict[str, frozenset[str]]
    instances: dict[str, str]
    formulas: tuple[str, ...]

    @property
    def texts(self) -> tuple[_Label, ...]:
        return (*self.declarations, *self.labels)


def check_rules(xml_text: str, queries: Sequence[str]) -> list[str]:
    """One sentence for each rule that a document or one of its queries breaks; empty when UPPAAL will take both.

    The rules are those of docs/uppaal.md. The queries inside the document are checked too.
    """
    if not _DOCTYPE.search(xml_text):
        return ["DOCTYPE: the document must name UPPAAL's flat-1_x DTD, or the editor refuses it"]
    parser = XMLParser()
    try:
        parser.feed(xml_text)
        root = parser.close()
    except ParseError as error:
        return [f"XML: the document is not well-formed ({error})"]
    formulas = [text for element in root.iterfind("queries/query/formula") if (text := element.text)]
    declarations = [_Label("", "declaration", _bare(root.findtext("declaration") or ""))]
    labels: list[_Label] = []
    locations = {}
    for template in root.iterfind("template"):
        name = template.findtext("name") or ""
        declarations.append(_Label(name, "declaration", _bare(template.findtext("declaration") or "")))
        locations[name] = frozenset(text for place in template.iterfind("location/name") if (text := place.text))
        for label in template.iterfind(".//label"):
            if label.get("kind") in LABELS:
                labels.append(_Label(name, str(label.get("kind")), label.text or ""))
    declared = {}
    for declaration in declarations:
        lists = _DECLARED.findall(declaration.text)
        # Without sizes, initial values and braces only the names are left.
        names = [re.findall(r"[A-Za-z_]\w*", re.sub(r"\{[^}]*\}|\[[^\]]*\]|=[^,]*", "", each)) for each in lists]
        declared[declaration.template] = frozenset(name for several in names for name in several)
    document = _ParsedDocument(
        root=root,
        labels=tuple(labels),
        declarations=tuple(declarations),
        declared=declared,
        locations=locations,
        instances=dict(re.findall(r"(\w+)\s*=\s*(\w+)\s*\(\s*\)\s*;", _bare(root.findtext("system") or ""))),
        formulas=tuple(dict.fromkeys([*formulas, *queries])),
    )
    return [f"{name}: {sentence}" for name, rule in RULES.items() for sentence in rule(document)]


def _bare(text: str) -> str:
    """Declarations without comments."""
    return re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.DOTALL)


def _structure(document: _ParsedDocument) -> list[str]:
    """Every reference leads to a location, every template starts somewhere, each id and name stands once."""
    sentences = []
    for template in document.root.iterfind("template"):
        name = template.findtext("name")
        ids = [location.get("id") for location in template.iterfind("location")]
        names = [text for element in template.iterfind("location/name") if (text := element.text)]
        references = [
            end.get("ref") for end in (*template.iterfind("transition/source"), *template.iterfind("transition/target"))
        ]
        start = template.find("init")
        if start is None or start.get("ref") not in ids:
            sentences.append(f"template {name} has no initial location among its own")
        sentences += [
            f"template {name} has an edge to {ref!r}, which is no location" for ref in references if ref not in ids
        ]
        sentences += [
            f"template {name} has the location {repeated!r} twice"
            for repeated in sorted({text for text in names if names.count(text) > 1})
        ]
    every = [location.get("id") for location in document.root.iterfind("template/location")]
    sentences += [
        f"the id {repeated!r} stands twice"
        for repeated in sorted({str(number) for number in every if every.count(number) > 1})
    ]
    order = [child.tag for child in document.root]
    wanted = ["declaration", *["template"] * order.count("template"), "system", "queries"]
    return (
        sentences if order == wanted else [*sentences, f"the parts stand as {order}, and UPPAAL reads them as {wanted}"]
    )


def _words(document: _ParsedDocument) -> list[str]:
    """No name is one of UPPAAL's words, and none is longer than older parsers read."""
    names = [
        (where, name) for where, many in (*document.declared.items(), *document.locations.items()) for name in many
    ]
    wrong = [(where, name) for where, name in names if name in KEYWORDS | FUNCTIONS or len(name) > 63]
    return [
        f"{where or 'global'} declares {name!r}, a word of UPPAAL or longer than 63 signs"
        for where, name in sorted(wrong)
    ]


def _ascii(document: _ParsedDocument) -> list[str]:
    bad = [label.place() for label in document.texts if not label.text.isascii()]
    bad += [f"query {formula!r}" for formula in document.formulas if not formula.isascii()]
    return [f"{where} has signs other than ASCII; write <= and not its one-sign form" for where in bad]


def _functions(document: _ParsedDocument) -> list[str]:
    texts = [(label.place(), label.text) for label in document.texts]
    texts += [(f"query {formula!r}", formula) for formula in document.formulas]
    return [
        f"{where} calls min( or max(; UPPAAL has fmin and fmax"
        for where, text in texts
        if re.search(r"(?<!\w)(?:min|max)\s*\(", text)
    ]


def _known_names(document: _ParsedDocument) -> list[str]:
    """Labels use only declared names and built-in functions."""
    sentences = []
    everywhere = document.declared[""] | FUNCTIONS | {"true", "false"}
    for label in document.labels:
        own = document.declared[label.template]
        unknown = [
            name
            for name in _NAME.findall(label.text)
            if name not in everywhere and name not in own and not re.fullmatch(r"[eE]\d*", name)
        ]
        if unknown:
            sentences.append(f"{label.place()} uses {unknown[0]!r}, which nothing declares")
    return sentences


def _literals(document: _ParsedDocument) -> list[str]:
    """A double is written with a point: `1.0`, never `1`; nan and inf are no literals."""
    sentences = []
    for declaration in document.declarations:
        for name, value in re.findall(r"\bdouble\s+(\w+)\s*(?:\[[^\]]*\])?\s*=\s*([^;]*);", declaration.text):
            literals = [part.strip() for part in value.strip().strip("{}").split(",")]
            wrong = [
                part for part in literals if not re.fullmatch(r"-?(?:\d+\.\d+(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)", part)
            ]
            sentences += [
                f"the double {name} is given {part!r}; write a finite number with a point, as 1.0" for part in wrong[:1]
            ]
    return sentences


def _draws(document: _ParsedDocument) -> list[str]:
    """Random draws stand in updates only, and no normal has the width 0."""
    sentences = [
        f"{label.place()} draws a random number; only updates may"
        for label in document.labels
        if label.kind != "assignment" and "random" in label.text
    ]
    sentences += [
        f"{declaration.place()} declares a random number; only updates may draw"
        for declaration in document.declarations
        if "random" in declaration.text
    ]
    zero = {
        name
        for declaration in document.declarations
        for name in re.findall(r"\b(\w+)\s*=\s*-?0\.0\s*;", declaration.text)
    }
    for label in document.labels:
        widths = re.findall(r"random_normal\(\s*[\w.+-]+\s*,\s*([\w.+-]+)\s*\)", label.text)
        sentences += [
            f"{label.place()} draws a normal of width 0"
            for width in widths
            if width in zero or re.fullmatch(r"0(?:\.0*)?", width)
        ]
    return sentences


def _replayed_times(document: _ParsedDocument) -> list[str]:
    """A clock that is reset at each event is compared with deltas, one that is not with cumulative times."""
    sentences = []
    arrays = dict(re.findall(r"const\s+double\s+(\w+)\s*\[[^\]]*\]\s*=\s*\{([^}]*)\}", document.declarations[0].text))
    for template in document.locations:
        own = [label for label in document.labels if label.template == template]
        pairs = {
            pair
            for label in own
            if label.kind in ("guard", "invariant")
            for pair in re.findall(r"\b(\w+)\s*[<>]=\s*(\w+)\s*\[", label.text)
        }
        for clock, name in sorted(pairs):
            reset = any(
                re.search(rf"(?<!\w){clock}\s*=(?!=)", label.text) for label in own if label.kind == "assignment"
            )
            values = [float(part) for part in arrays.get(name, "").split(",") if part.strip()]
            rising = all(first <= second for first, second in pairwise(values))
            if reset and name.endswith("_TIMES"):
                sentences.append(
                    f"{template} resets {clock} and compares it with the cumulative {name}; use deltas or no reset"
                )
            elif not reset and (name.endswith("_DELTAS") or not rising):
                sentences.append(f"{template} never resets {clock}, so {name} must be cumulative and never fall")
    return sentences


def _losses(document: _ParsedDocument) -> list[str]:
    """A broadcast event that no edge takes is lost silently: what receives one must count it."""
    broadcast = set(re.findall(r"broadcast\s+chan\s+(\w+)", document.declarations[0].text))
    sentences = []
    for transition in document.root.iterfind("template/transition"):
        texts = {label.get("kind"): label.text or "" for label in transition.iterfind("label")}
        channel = texts.get("synchronisation", "")
        if channel.endswith("?") and channel[:-1] in broadcast and "taken" not in texts.get("assignment", ""):
            sentences.append(f"an edge receives {channel} without counting it, so that a lost event would not show")
    return sentences[:1]


def _channels_of_queries(document: _ParsedDocument) -> list[str]:
    """Statistical queries need broadcast channels, the compatibility question binary ones."""
    text = document.declarations[0].text
    binary = bool(re.search(r"(?<!broadcast )\bchan\b", text))
    sentences = [
        f"query {formula!r} is statistical and the model has a binary channel; use broadcast chan"
        for formula in document.formulas
        if binary and _STATISTICAL.search(formula)
    ]
    vacuous = [formula for formula in document.formulas if re.match(r"\s*A\s*<>", formula) and "broadcast" in text]
    return sentences + [f"query {formula!r} is vacuous over broadcast channels; use binary ones" for formula in vacuous]


def _symbolic(document: _ParsedDocument) -> list[str]:
    hybrid = any("hybrid clock" in declaration.text for declaration in document.declarations)
    return [
        f"query {formula!r} is symbolic, and UPPAAL decides nothing about hybrid clocks; ask Pr[<=T]([] ...)"
        for formula in document.formulas
        if hybrid and _SYMBOLIC.match(formula)
    ]


def _query_forms(document: _ParsedDocument) -> list[str]:
    """Order, bounds, signs and thresholds of queries."""
    return [
        f"query {formula!r} {sentence}"
        for formula in document.formulas
        for pattern, sentence in FORMS
        if pattern.search(formula)
    ]


FORMS: tuple[tuple[re.Pattern[str], str], ...] = (
    (re.compile(r"\bsimulate\s+\d"), "puts the runs first; write simulate [<=T; N] {...}"),
    (re.compile(r"\bsimulate\b(?!\s*\[)"), "has no bound; write simulate [<=T; N] {...}"),
    (re.compile(r"(?<![<>=!])=(?!=)"), "has a single =; write =="),
    (re.compile(r"\(\s*final\s*:"), "asks for a final value, which UPPAAL does not know; ask max: or min:"),
    (re.compile(r"\[\s*<=\s*(?!\d+\s*[;\]])"), "has a bound that is no whole number of seconds"),
    (re.compile(r"\)\s*[<>]=\s*-?\d+(?![\d.eE])"), "has a threshold without a point; write 1.0"),
    (re.compile(r"\bE\s*\[\s*<=\s*\d+\s*\]"), "has no number of runs; write E[<=T; N](max: ...)"),
)


def _check_qualification(document: _ParsedDocument) -> list[str]:
    """A query names what belongs to a process by m_1.name, and only what is there."""
    sentences = []
    known = document.declared[""] | FUNCTIONS | KEYWORDS
    for formula in document.formulas:
        for name in re.findall(r"(?<![\w.])[A-Za-z_]\w*(?:\.\w+)?", re.sub(_NUMBER, " ", formula)):
            process, _, member = name.partition(".")
            template = document.instances.get(process)
            if member and (
                template is None or member not in document.declared[template] | document.locations[template]
            ):
                sentences.append(f"query {formula!r} names {name!r}, which the model does not have")
            elif not member and name not in known:
                sentences.append(f"query {formula!r} names {name!r}; write it with its process, as m_1.{name}")
    return sentences


RULES: dict[str, Callable[[_ParsedDocument], list[str]]] = {
    "structure": _structure,
    "words": _words,
    "ASCII": _ascii,
    "fmin": _functions,
    "declared names": _known_names,
    "literals": _literals,
    "random draws": _draws,
    "replayed times": _replayed_times,
    "lost events": _losses,
    "channels": _channels_of_queries,
    "symbolic queries": _symbolic,
    "query forms": _query_forms,
    "qualified names": _check_qualification,
}
"""Name of a rule -> what is wrong, one sentence each."""
