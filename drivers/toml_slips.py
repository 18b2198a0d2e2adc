"""What would be right where a text is not TOML: the slips that people make, each by how its place looks."""

import re

_AT = re.compile(r"\(at line (\d+), column (\d+)\)")
_SLIPS = tuple(
    (re.compile(look), remedy)
    for look, remedy in (
        ("[“”„‟«»‘’‚‛]", "write straight quotes around a text"),
        ("[\u00a0\u2007\u202f\u3000]", "a space there is no plain one; type it anew"),
        (r'"[^"]*\\[^"]*', "write a path with / between its parts, or in single quotes"),
        (r"=\s*[+-]?\d+,\d+", "write a decimal point, and no comma"),
        (r"=\s*[+-]?0\d+(?![\d:/-]|\.\d+\.)", "write a number without a 0 before it"),
        # Neither what begins as 0x10 and 1e3 do, nor a key.
        (
            r"=\s*[+-]?(?!0[xXoObB])\d[\d.]*\s*(?:(?![eE](?![^\W\d_]))[^\W\d_]+(?![\w.-]*\s*=)|[%°])",
            "write a number without its unit",
        ),
        (r"=\s*(?i:true|false|yes|no|on|off)\b", "write true or false"),
        (r"=\s*(?i:null|none|nil)\b", "leave the key out where there is no value"),
        (r"=\s*(?=$|#|,|\})", "give the key a value"),
        (r"=\s*[+-]?(?:\.\d+|\d+\.(?!\d))", "write a number with digits on both sides of its point"),
        (r"=\s*[^\W\d]\S*|=\s*[~/.<$]\S*|=\s*\d+(?:[:-]\d|/\d+/\d|\.\d+\.\d)\S*", "write a text in quotes"),
        (r"^\s*[\w.-]+\s*:", "write key = value"),
        (r"^\s*[{<]", "this is another format; write [table] and below it key = value"),
        (
            r"\{(?:[^{}]|\{[^{}]*\})*(,\s*(?=\}|$))",
            "close a { table } on its line, without a comma before its end",
        ),
    )
)
"""How a slip looks in its line (its place is that of the group, where there is one), and what would be right."""
_BEHIND_A_VALUE = "Expected newline or end of document"
_SLIPS_BEHIND_A_VALUE = tuple(
    (re.compile(look), remedy)
    for look, remedy in (
        (r",\s*(?:#.*)?$", "write no comma at the end of a line"),
        (r"[\w.-]+\s*=", "write each key on a line of its own"),
    )
)
"""How what follows a value on its line looks from its first character on, where that is the slip."""
_TWICE = ("Cannot overwrite", "Cannot declare", "Cannot redefine", "Cannot mutate", "Duplicate")
_OPEN = ("Illegal character '\\n'", 'Expected "\'"', "Unterminated string")
_BYTE_ORDER_MARK = "\ufeff"


def toml_remedy(text: str, error: str) -> str:
    """What would be right in a text that is no TOML by the message of its parser."""
    if text.startswith(_BYTE_ORDER_MARK):
        return "the file begins with a byte order mark; save it as UTF-8 without one"
    if error.startswith(_TWICE):
        return "it is there already; keep one of the two"
    if error.startswith(_OPEN):
        return "close the quotes of a text where it ends"
    found = _AT.search(error)
    if found is None:
        return "correct that place"
    number, column = int(found[1]), int(found[2])
    line = text.splitlines()[number - 1] if number <= len(text.splitlines()) else ""
    if error.startswith(_BEHIND_A_VALUE):
        for look, remedy in _SLIPS_BEHIND_A_VALUE:
            if look.match(line, column - 1):
                return remedy
    for look, remedy in _SLIPS:
        # A slip elsewhere in the line is not what the parser stopped at.
        if any(slip.start(look.groups) <= column <= slip.end(look.groups) + 1 for slip in look.finditer(line)):
            return remedy
    return "correct that place"
