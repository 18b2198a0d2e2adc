"""Text from outside as one line that may be stored and shown: what is not printable is written as its escape."""

from collections.abc import Mapping


def one_line(text: str) -> str:
    r"""The text with every line break, ESC, other control or direction character as `\n`, `\x1b`, `\u202e`.

    So a name can neither begin a line of its own in a log, nor steer the terminal that shows it, nor, as a lone
    surrogate, be refused by whoever stores UTF-8.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def printable(value: object) -> object:
    """A plain value with all its texts as one line each; what is neither number, text nor None becomes its text."""
    if isinstance(value, Mapping):
        return {one_line(str(key)): printable(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [printable(inner) for inner in value]
    return value if value is None or isinstance(value, int | float) else one_line(str(value))
