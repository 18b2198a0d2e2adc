"""The query language's grammar, and what is wrong with a text that does not follow it, in one sentence.

Precedence is that of UPPAAL's own parser, tightest first: `!` and the unary minus, `*` `/`, `+` `-`, comparisons, `&&`,
and on one level, from the left, `||` and `imply`. Numbers and conditions share the grammar; `parse` tells them apart,
because it can then say which of them was expected where.
"""

import re
from functools import cache
from types import MappingProxyType

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedCharacters, UnexpectedInput, UnexpectedToken
from lark.tree import Meta

from sim.strict_json import escape_text

GRAMMAR = r"""
start: estimate | hypothesis | comparison | expectation | simulation | symbolic | leads_to
estimate: probability
hypothesis: probability (LE | GE) number
comparison: probability (LE | GE) probability
probability: PR bounds? "(" (eventually | always | until | response) ")"
expectation: EXISTS bounds "(" EXTREME ":" _formula ")"
simulation: SIMULATE number? bounds LBRACE _formula (COMMA _formula)* RBRACE
symbolic: (EXISTS | ALL) (DIAMOND | BOX) _formula
leads_to: _formula LEADSTO _formula

bounds: "[" LE number (";" number)? "]"
eventually: DIAMOND interval? _formula
always: BOX interval? _formula
until: _formula UNTIL interval? _formula
response: _formula LEADSTO interval? _formula within? view?
interval: "[" number COMMA number "]"
within: NAME number
view: NAME
number: MINUS? NUMBER

_formula: disjunction
?disjunction: conjunction ((OR | IMPLY) conjunction)*
?conjunction: relation (AND relation)*
?relation: sum ((LT | LE | EQ | NE | GE | GT) sum)*
?sum: product ((PLUS | MINUS) product)*
?product: unary ((TIMES | OVER) unary)*
?unary: NOT unary -> negation
      | MINUS unary -> minus
      | PLUS unary -> plus
      | atom
?atom: NAME -> name
     | AT -> own_name
     | NUMBER -> literal
     | (TRUE | FALSE) -> truth
     | DEADLOCK -> deadlock
     | "(" disjunction ")"

PR.3: /Pr\b/
SIMULATE.3: /simulate\b/
EXISTS.3: /E\b/
ALL.3: /A\b/
UNTIL.3: /U\b/
EXTREME.3: /(max|min)\b/
AND.3: /and\b|&&|∧/
OR.3: /or\b|\|\||∨/
NOT.3: /not\b|!(?!=)|¬/
IMPLY.3: /imply\b/
TRUE.3: /true\b/
FALSE.3: /false\b/
DEADLOCK.3: /deadlock\b/
AT.3: /at\s*(?:"(?:[^"\\]|\\.)*"|'(?:[^'\\]|\\.)*')/
LEADSTO.3: /-->/
DIAMOND.3: /<>|◇/
BOX.3: /\[\s*\]|□/
LE.2: /<=|≤|⩽/
GE.2: />=|≥|⩾/
NE.2: /!=|≠/
EQ: "=="
LT: "<"
GT: ">"
PLUS: "+"
MINUS: /-|−/
TIMES: "*"
OVER: "/"
LBRACE: "{"
RBRACE: "}"
COMMA: ","
NUMBER: /(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?/
NAME: /[^\W\d]\w*(?:\.\w+)*/
COMMENT.4: /\/\/[^\n]*|\/\*(?:.|\n)*?\*\//
%ignore COMMENT
%ignore /\s+/
"""

FORMS = (
    "a query is Pr[<=444](<> Temp > 80), simulate [<=444; 10] {Temp}, E[<=444; 1000](max: Temp), A[] !deadlock "
    "or another form of docs/checking.md"
)
MOST_PARTS, MOST_CHARACTERS = 300, 50_000
"""Names, numbers and operators of one query, and its characters: more is no question that a person asks."""

MAX_QUOTE_CHARS = 60

_NUMBERS = {"NUMBER", "PLUS", "MINUS"}
_TOKEN_NAMES = MappingProxyType(
    {
        "LPAR": "'('", "RPAR": "')'", "LSQB": "'['", "RSQB": "']'", "LBRACE": "'{'", "RBRACE": "'}'", "COMMA": "','",
        "SEMICOLON": "';'", "COLON": "':'", "LE": "'<='", "GE": "'>='", "LEADSTO": "'-->'", "UNTIL": "'U'",
        "DIAMOND": "'<>'", "BOX": "'[]'", "PR": "'Pr'", "EXTREME": "'max' or 'min'", "$END": "the end of the query",
    }
)  # fmt: skip
_SIGNS = MappingProxyType(
    {
        "=": "numbers are compared with == <= >=",
        "&": "'and' is written && or and",
        "|": "'or' is written || or or",
        "#": "steps are not counted here; bound the time, as in [<=444]",
        '"': 'a location is named in its own words by at "ON/200-300"',
        "'": "rates are not known here; a location is named in its own words by at 'ON/200-300'",
        "?": "there is no choice by ? here; write (c && a) || (!c && b)",
        "%": "percentages and remainders are not known here; a probability is written 0.9",
        "^": "powers are not known here; write x * x",
        "→": "'leads to' is written -->",
    }
)
_FIRST_WORD_HINTS = MappingProxyType(
    {
        "sup": "ask E[<=444; 1000](max: Temp), or `decanter model judge proof` for a bound that is proven",
        "inf": "ask E[<=444; 1000](min: Temp), or `decanter model judge proof` for a bound that is proven",
        "bounds": "ask E[<=444; 1000](max: Temp), or `decanter model judge proof` for a bound that is proven",
        "control": "there is no strategy to be found: the events come from the plant",
        "strategy": "there is no strategy to be found: the events come from the plant",
        "minE": "there is no strategy to be found: the events come from the plant",
        "maxE": "there is no strategy to be found: the events come from the plant",
    }
)
_QUERY_KEYWORDS = MappingProxyType({"pr": "Pr", "e": "E", "a": "A", "simulate": "simulate"})


class QueryError(ValueError):
    """A query cannot be read, or asks what cannot be answered: where, what stands there, what would be right.

    It is one line of printable characters, whatever the query holds.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(escape_text(sentence))


@cache
def _parser() -> Lark:
    # The basic lexer: a keyword is one wherever it stands, as it is for UPPAAL.
    return Lark(GRAMMAR, parser="lalr", lexer="basic", propagate_positions=True)


def syntax(text: str) -> Tree[Token]:
    """The syntax tree of a query. Raises QueryError."""
    if not text.strip():
        raise QueryError(f"the query is empty; {FORMS}")
    if len(text) > MOST_CHARACTERS:
        raise QueryError(f"the query has {len(text)} characters, and {MOST_CHARACTERS} is the most")
    try:
        tree = _parser().parse(text)
    except UnexpectedInput as error:
        raise QueryError(_sentence(error, text)) from None
    parts = sum(isinstance(part, Token) for subtree in tree.iter_subtrees() for part in subtree.children)
    if parts > MOST_PARTS:
        raise QueryError(f"the query has {parts} parts, and {MOST_PARTS} is the most; ask several shorter ones")
    return tree


def quote_part(text: str) -> str:
    """A part of the query as an error quotes it: cut off where it is long."""
    return str(text) if len(text) <= MAX_QUOTE_CHARS else f"{text[: MAX_QUOTE_CHARS - 3]}..."


def query_error(place: Token | Meta, sentence: str) -> QueryError:
    """The error `column 9: sentence`; with the line where it is not the first."""
    line, column = place.line, place.column
    return QueryError(f"{f'line {line}, ' if line and line > 1 else ''}column {column}: {sentence}")


def _sentence(error: UnexpectedInput, text: str) -> str:
    # First what people bring along from UPPAAL's other queries: the parser's own complaint would not help them.
    first = text.split(maxsplit=1)[0].rstrip(":({[")
    place = Token("", "", line=error.line, column=error.column)
    if first in _FIRST_WORD_HINTS:
        return f"{first} is not asked here; {_FIRST_WORD_HINTS[first]}"
    begun = re.match(r"\s*(\w+)\s*[\[({<]", text)
    if begun and begun[1] != (right := _QUERY_KEYWORDS.get(begun[1].casefold(), begun[1])):
        return f"column {begun.start(1) + 1}: a query begins with {right}, not with {begun[1]}; {FORMS}"
    if isinstance(error, UnexpectedCharacters):
        sign = text.split("\n")[error.line - 1][error.column - 1]
        return str(query_error(place, f"found {sign!r}; {_SIGNS.get(sign, f'no query has this sign; {FORMS}')}"))
    if not isinstance(error, UnexpectedToken):
        return str(query_error(place, FORMS))
    # `accepts` is what the parser could really take here; `expected` has also what it would refuse a step later.
    token, wanted = error.token, frozenset(error.accepts or error.expected)
    if token.type == "$END":
        if {"LEADSTO"} <= wanted and not wanted & {"RPAR", "UNTIL"}:
            return f"the query is a condition alone; {FORMS}"
        return f"the query ends too early; right would be {_expectation_text(wanted)}"
    if token.type == "LPAR" and re.search(r"\b[^\W\d]\w*\s*$", text[: token.start_pos]):
        hint = "no function is known here; write sums, differences, products and quotients"
    elif str(token) == "under":
        hint = "there is no strategy to be used: the events come from the plant"
    elif wanted == {"LEADSTO"}:
        hint = f"after a condition right would be an operator or '-->'; {FORMS}"
    elif "NAME" in wanted and re.fullmatch(r"[^\W\d]\w*", token):
        hint = f'{token} is a word of the language; a location of that name is named by at "{token}"'
    elif wanted <= {"DIAMOND", "BOX", "LSQB"} and (word := re.search(r"\b[AE](?=\s*$)", text[: token.start_pos])):
        hint = f'right would be {_expectation_text(wanted)}; a location called {word[0]} is named by at "{word[0]}"'
    else:
        hint = f"right would be {_expectation_text(wanted)}"
    return str(query_error(token, f"found {quote_part(token)!r}; {hint}"))


def _expectation_text(wanted: frozenset[str]) -> str:
    """The terminals that would be right, in words; operands and operators as one word each."""
    if "SIMULATE" in wanted:
        return f"the beginning of a query; {FORMS}"
    words = [_TOKEN_NAMES[name] for name in _TOKEN_NAMES if name in wanted]
    if {"NAME", "NUMBER"} <= wanted:
        words = ["a name, a number, '!' or '('", *(word for word in words if word not in ("'('",))]
    elif "NUMBER" in wanted:
        words = ["a number", *words]
    if {"TIMES", "AND"} & wanted:
        words = ["an operator", *(word for word in words if word not in ("'<='", "'>='"))]
    return " or ".join(words)
