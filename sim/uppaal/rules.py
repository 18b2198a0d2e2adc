"""The rules that UPPAAL's parser and engine hold an exported document to, checked on the emitted text."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from xml.etree.ElementTree import Element, ParseError, XMLParser

from sim.checking.query import FUNCTIONS, KEYWORDS

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

    def where(self) -> str:
        return f"{self.template or 'global'} {self.kind} {self.text[:60]!r}"


@dataclass(frozen=True, slots=True)
class _Document:
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
    document = _Document(
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


def _structure(document: _Document) -> list[str]:
    """Every reference leads to a location, every template starts somewhere, each id and name stands once."""
    found = []
    for template in document.root.iterfind("template"):
        name = template.findtext("name")
        ids = [location.get("id") for location in template.iterfind("location")]
        names = [text for one in template.iterfind("location/name") if (text := one.text)]
        references = [
            one.get("ref") for one in (*template.iterfind("transition/source"), *template.iterfind("transition/target"))
        ]
        start = template.find("init")
        if start is None or start.get("ref") not in ids:
            found.append(f"template {name} has no initial location among its own")
        found += [
            f"template {name} has an edge to {ref!r}, which is no location" for ref in references if ref not in ids
        ]
        found += [
            f"template {name} has the location {one!r} twice"
            for one in sorted({one for one in names if names.count(one) > 1})
        ]
    every = [one.get("id") for one in document.root.iterfind("template/location")]
    found += [f"the id {one!r} stands twice" for one in sorted({str(one) for one in every if every.count(one) > 1})]
    order = [child.tag for child in document.root]
    wanted = ["declaration", *["template"] * order.count("template"), "system", "queries"]
    return found if order == wanted else [*found, f"the parts stand as {order}, and UPPAAL reads them as {wanted}"]


def _words(document: _Document) -> list[str]:
    """No name is one of UPPAAL's words, and none is longer than older parsers read."""
    names = [(where, one) for where, many in (*document.declared.items(), *document.locations.items()) for one in many]
    wrong = [(where, one) for where, one in names if one in KEYWORDS | FUNCTIONS or len(one) > 63]
    return [
        f"{where or 'global'} declares {one!r}, a word of UPPAAL or longer than 63 signs"
        for where, one in sorted(wrong)
    ]


def _ascii(document: _Document) -> list[str]:
    bad = [one.where() for one in document.texts if not one.text.isascii()]
    bad += [f"query {formula!r}" for formula in document.formulas if not formula.isascii()]
    return [f"{where} has signs other than ASCII; write <= and not its one-sign form" for where in bad]


def _functions(document: _Document) -> list[str]:
    texts = [(one.where(), one.text) for one in document.texts]
    texts += [(f"query {formula!r}", formula) for formula in document.formulas]
    return [
        f"{where} calls min( or max(; UPPAAL has fmin and fmax"
        for where, text in texts
        if re.search(r"(?<!\w)(?:min|max)\s*\(", text)
    ]


def _known_names(document: _Document) -> list[str]:
    """Labels use only declared names and built-in functions."""
    found = []
    for label in document.labels:
        known = document.declared[""] | document.declared[label.template] | FUNCTIONS | {"true", "false"}
        unknown = [
            name for name in _NAME.findall(label.text) if name not in known and not re.fullmatch(r"[eE]\d*", name)
        ]
        if unknown:
            found.append(f"{label.where()} uses {unknown[0]!r}, which nothing declares")
    return found


def _literals(document: _Document) -> list[str]:
    """A double is written with a point: `1.0`, never `1`; nan and inf are no literals."""
    found = []
    for one in document.declarations:
        for name, value in re.findall(r"\bdouble\s+(\w+)\s*(?:\[[^\]]*\])?\s*=\s*([^;]*);", one.text):
            literals = [part.strip() for part in value.strip().strip("{}").split(",")]
            wrong = [
                part for part in literals if not re.fullmatch(r"-?(?:\d+\.\d+(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)", part)
            ]
            found += [
                f"the double {name} is given {part!r}; write a finite number with a point, as 1.0" for part in wrong[:1]
            ]
    return found


def _draws(document: _Document) -> list[str]:
    """Random draws stand in updates only, and no normal has the width 0."""
    found = [
        f"{one.where()} draws a random number; only updates may"
        for one in document.labels
        if one.kind != "assignment" and "random" in one.text
    ]
    found += [
        f"{one.where()} declares a random number; only updates may draw"
        for one in document.declarations
        if "random" in one.text
    ]
    zero = {name for one in document.declarations for name in re.findall(r"\b(\w+)\s*=\s*-?0\.0\s*;", one.text)}
    for one in document.labels:
        widths = re.findall(r"random_normal\(\s*[\w.+-]+\s*,\s*([\w.+-]+)\s*\)", one.text)
        found += [
            f"{one.where()} draws a normal of width 0"
            for width in widths
            if width in zero or re.fullmatch(r"0(?:\.0*)?", width)
        ]
    return found


def _replayed_times(document: _Document) -> list[str]:
    """A clock that is reset at each event is compared with deltas, one that is not with cumulative times."""
    found = []
    arrays = dict(re.findall(r"const\s+double\s+(\w+)\s*\[[^\]]*\]\s*=\s*\{([^}]*)\}", document.declarations[0].text))
    for template in document.locations:
        own = [one for one in document.labels if one.template == template]
        pairs = {
            pair
            for one in own
            if one.kind in ("guard", "invariant")
            for pair in re.findall(r"\b(\w+)\s*[<>]=\s*(\w+)\s*\[", one.text)
        }
        for clock, name in sorted(pairs):
            reset = any(re.search(rf"(?<!\w){clock}\s*=(?!=)", one.text) for one in own if one.kind == "assignment")
            values = [float(part) for part in arrays.get(name, "").split(",") if part.strip()]
            rising = all(first <= second for first, second in pairwise(values))
            if reset and name.endswith("_TIMES"):
                found.append(
                    f"{template} resets {clock} and compares it with the cumulative {name}; use deltas or no reset"
                )
            elif not reset and (name.endswith("_DELTAS") or not rising):
                found.append(f"{template} never resets {clock}, so {name} must be cumulative and never fall")
    return found


def _losses(document: _Document) -> list[str]:
    """A broadcast event that no edge takes is lost silently: what receives one must count it."""
    broadcast = set(re.findall(r"broadcast\s+chan\s+(\w+)", document.declarations[0].text))
    found = []
    for transition in document.root.iterfind("template/transition"):
        texts = {label.get("kind"): label.text or "" for label in transition.iterfind("label")}
        channel = texts.get("synchronisation", "")
        if channel.endswith("?") and channel[:-1] in broadcast and "taken" not in texts.get("assignment", ""):
            found.append(f"an edge receives {channel} without counting it, so that a lost event would not show")
    return found[:1]


def _channels_of_queries(document: _Document) -> list[str]:
    """Statistical queries need broadcast channels, the compatibility question binary ones."""
    text = document.declarations[0].text
    binary = bool(re.search(r"(?<!broadcast )\bchan\b", text))
    found = [
        f"query {formula!r} is statistical and the model has a binary channel; use broadcast chan"
        for formula in document.formulas
        if binary and _STATISTICAL.search(formula)
    ]
    vacuous = [formula for formula in document.formulas if re.match(r"\s*A\s*<>", formula) and "broadcast" in text]
    return found + [f"query {formula!r} is vacuous over broadcast channels; use binary ones" for formula in vacuous]


def _symbolic(document: _Document) -> list[str]:
    hybrid = any("hybrid clock" in one.text for one in document.declarations)
    return [
        f"query {formula!r} is symbolic, and UPPAAL decides nothing about hybrid clocks; ask Pr[<=T]([] ...)"
        for formula in document.formulas
        if hybrid and _SYMBOLIC.match(formula)
    ]


def _query_forms(document: _Document) -> list[str]:
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


def _qualified(document: _Document) -> list[str]:
    """A query names what belongs to a process by m_1.name, and only what is there."""
    found = []
    known = document.declared[""] | FUNCTIONS | KEYWORDS
    for formula in document.formulas:
        for name in re.findall(r"(?<![\w.])[A-Za-z_]\w*(?:\.\w+)?", re.sub(_NUMBER, " ", formula)):
            process, _, member = name.partition(".")
            template = document.instances.get(process)
            if member and (
                template is None or member not in document.declared[template] | document.locations[template]
            ):
                found.append(f"query {formula!r} names {name!r}, which the model does not have")
            elif not member and name not in known:
                found.append(f"query {formula!r} names {name!r}; write it with its process, as m_1.{name}")
    return found


RULES: dict[str, Callable[[_Document], list[str]]] = {
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
    "qualified names": _qualified,
}
"""Name of a rule -> what is wrong, one sentence each."""
