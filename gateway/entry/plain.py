"""Text for a terminal or pipe that has no word for a sign: what it can show, never a traceback."""

import codecs
import io
import unicodedata
from typing import TextIO

SIGNS = {"°": "deg", "–": "-", "—": "-", "…": "...", "±": "+-", "→": "->", "≤": "<=", "≥": ">=", "·": "*", "×": "x"}


def plain(error: UnicodeError) -> tuple[str, int]:
    """An error handler of codecs: a sign that the encoding lacks by its name above, without its accent, or as `?`."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    bare = ""
    for sign in error.object[error.start : error.end]:
        bare += SIGNS.get(sign) or unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode() or "?"
    return bare, error.end


def write_plainly(stream: TextIO) -> None:
    """Let the stream take any text, whatever its encoding (LC_ALL=C, PYTHONIOENCODING=ascii)."""
    codecs.register_error("decanter.plain", plain)
    if isinstance(stream, io.TextIOWrapper) and stream.errors in ("strict", "surrogateescape"):
        stream.reconfigure(errors="decanter.plain")
