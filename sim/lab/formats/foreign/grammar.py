"""What the grammars of the artefacts share: errors as sentences, and the parts of a syntax tree."""

from collections.abc import Iterator
from pathlib import Path

from lark import Lark, Token, Tree, UnexpectedEOF, UnexpectedInput
from lark.exceptions import UnexpectedToken

from sim.files import file_error


def parse_text(parser: Lark, text: str, file: str | Path, wanted: str) -> Tree[Token]:
    """The syntax tree of `text`. Raises ArtefactError with the line and what stands there, then `wanted`."""
    try:
        return parser.parse(text)
    except UnexpectedInput as error:
        if isinstance(error, UnexpectedEOF) or (isinstance(error, UnexpectedToken) and error.token.type == "$END"):
            line = max(1, len(text.rstrip().splitlines()))
            raise file_error(file, line, f"the text ends too early; {wanted}") from None
        rest = text.split("\n")[error.line - 1][error.column - 1 :][:40]
        reason = f"unexpected {rest!r}" if rest else "the line ends too early"
        raise file_error(file, error.line, f"{reason} at column {error.column}; {wanted}") from None


def finite(token: Token, file: str | Path, what: str) -> float:
    """The token as a finite number. Raises ArtefactError with the line otherwise."""
    return finite_number(str(token), file, token.line, what)


def finite_number(text: str, file: str | Path, line: int | None, what: str) -> float:
    """`text` as a finite number. Raises ArtefactError naming `what` otherwise."""
    try:
        value = float(text)
    except ValueError:
        raise file_error(file, line, f"{what} is {text[:60]!r}, which is no number; write one like 0.0031") from None
    if value - value != 0.0:
        raise file_error(file, line, f"{what} is {text[:60]!r}; a finite number is needed")
    return value


def trees(tree: Tree[Token] | None, kind: str | None = None) -> list[Tree[Token]]:
    """The subtrees directly below, all or of one kind; none below None."""
    children = tree.children if tree else []
    return [child for child in children if isinstance(child, Tree) and kind in (None, child.data)]


def tokens(tree: Tree[Token]) -> list[Token]:
    """The tokens directly below."""
    return [child for child in tree.children if isinstance(child, Token)]


def subtrees(tree: Tree[Token], kind: str) -> Iterator[Tree[Token]]:
    """All subtrees of one kind at any depth, in the text's order."""
    # A stack of its own and not a recursion: a text may nest deeper than Python calls.
    waiting = trees(tree)[::-1]
    while waiting:
        child = waiting.pop()
        if child.data == kind:
            yield child
        waiting += trees(child)[::-1]
