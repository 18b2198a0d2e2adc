"""Text from outside as one line that may be stored and shown: what is not printable is written as its escape."""


def one_line(text: str) -> str:
    r"""The text with every line break, ESC, other control or direction character as `\n`, `\x1b`, `\u202e`.

    So a name can neither begin a line of its own in a log, nor steer the terminal that shows it, nor, as a lone
    surrogate, be refused by whoever stores UTF-8.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
