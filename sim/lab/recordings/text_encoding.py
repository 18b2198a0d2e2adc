"""The encoding of a text that says none: by its mark, by its zeros, by the letters that come out."""

import codecs
import re
from contextlib import suppress
from pathlib import Path

from sim.lab.recordings.load_report import TraceError

BOMS = ((codecs.BOM_UTF8, "utf-8-sig"), (codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))


def decode_head(path: Path, head: bytes, encoding: str) -> tuple[str, str, str]:
    """(encoding, text of the head, a note if it is not what `encoding` says).

    A byte order mark says more than the map. Raises TraceError for what is no text.
    """
    bom = next((name for mark, name in BOMS if head.startswith(mark)), None)
    if bom is None and (unmarked := _unmarked(head)):
        bom = unmarked
    chosen, note = bom or (encoding if encoding != "auto" else "utf-8"), ""
    try:
        # Incrementally: the head may end in the middle of a character, which is no fault.
        text = codecs.getincrementaldecoder(chosen)("strict").decode(head, False)
    except UnicodeDecodeError:
        claimed, chosen = chosen, _code_page(head) if encoding == "auto" and bom is None else chosen
        text = head.decode(chosen, "replace")
        note = f"it is not clean {claimed} text; read as {chosen}"
    strange = sum(char < " " and char not in "\t\r\n\f" for char in text[:4096])
    if "\x00" in text[:4096] or strange * 20 > len(text[:4096]):
        raise TraceError(f"{path}: this is not a text file; give the CSV, unpacked")
    return chosen, text, note


_HIGH_BYTES = re.compile(rb"[\x80-\xff]+")
_FIRST_CYRILLIC = 0xC0
"""The first letter of cp1251, but for those that few words have."""
_MIN_WORD_BYTES = 4
"""Bytes above ASCII in a row, which no language of Western Europe writes: a word of another script."""


def _code_page(head: bytes) -> str:
    """The encoding of a head that is not UTF-8: Chinese, Cyrillic, Japanese or, for any other, Western.

    Western letters beyond ASCII stand alone, Chinese ones take two bytes each, both of them high.
    """
    body = head[: head.rfind(b"\n") + 1] or head
    runs = [match[0] for match in _HIGH_BYTES.finditer(body)]
    long = max(map(len, runs), default=0) >= _MIN_WORD_BYTES
    if long and all(len(run) % 2 == 0 for run in runs):
        with suppress(UnicodeDecodeError):
            b"".join(runs).decode("gb2312")
            return "gb18030"
    if _is_japanese(body):
        return "cp932"
    # cp1252 has a character for nearly every byte: umlauts and degree signs of old Windows files come out right.
    if not long:
        return "cp1252"
    letters = sum(byte >= _FIRST_CYRILLIC for run in runs for byte in run)
    return "cp1251" if 10 * letters >= 9 * sum(map(len, runs)) else "cp1252"


def _unmarked(head: bytes) -> str:
    """The encoding of a head whose every other byte is 0, as two bytes a letter are; "" for any other."""
    first, second = head[:4096:2], head[1:4096:2]
    halves = {"utf-16-le": (second, first), "utf-16-be": (first, second)}
    least = len(second) // 2
    return next((name for name, (zero, rest) in halves.items() if zero.count(0) > least > rest.count(0) * 20), "")


def _is_japanese(body: bytes) -> bool:
    """Whether a text is Shift-JIS: most letters beyond ASCII begin with a byte that Western code pages have for marks.

    Half of a letter may be a byte of ASCII there, as one behind an apostrophe: what tells are letters in a row.
    """
    try:
        words = [[each.encode("cp932") for each in word] for word in _BEYOND_ASCII.findall(body.decode("cp932"))]
    except UnicodeError:
        return False
    kinds = ["".join("+" if _JAPANESE.fullmatch(letter) else "-" for letter in word) for word in words]
    runs = [
        b"".join(word[slice(*found.span())])
        for word, kind in zip(words, kinds, strict=True)
        for found in re.finditer(r"\+{2,}", kind)
    ]
    return sum(map(len, set(runs))) >= _MIN_JAPANESE_BYTES and sum(map(len, runs)) > sum(map(len, words))


_BEYOND_ASCII = re.compile(r"[^\x00-\x7f]+")
_JAPANESE = re.compile(rb"[\x82-\x9f].", re.DOTALL)
"""Kana and the more common half of the kanji, but for marks and symbols."""
_MIN_JAPANESE_BYTES = 10
"""Bytes of different words: few letters in a row may be Slavic ones with a caron between vowels."""
