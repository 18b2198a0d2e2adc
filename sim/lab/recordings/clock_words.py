"""Times as people and programs write them, in words: months, days of the week, zones, halves of a day."""

import re

_MONTHS = (
    "jan january januar jänner jän gen gennaio janv janvier ene enero janeiro 一月",
    "feb february februar febbraio févr fevr fév février fevrier febrero fev fevereiro 二月",
    "mar march mär mrz märz maerz marzo mars março 三月",
    "apr april aprile avr avril abr abril 四月",
    "may mai mag maggio mayo maio 五月",
    "jun june juni giu giugno juin junio junho 六月",
    "jul july juli lug luglio juil juillet julio julho 七月",
    "aug august ago agosto août aout 八月",
    "sep sept september set settembre septembre septiembre setembro 九月",
    "oct october okt oktober ott ottobre octobre octubre out outubro 十月",
    "nov november novembre noviembre novembro 十一月",
    "dec december dez dezember dic dicembre déc décembre decembre diciembre dezembro 十二月",
)
"""Months in English, German, Italian, French, Spanish, Portuguese and Chinese, whole and short, as the year goes."""
_ENGLISH = ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"]
_MONTH = {word: name for words, name in zip(_MONTHS, _ENGLISH, strict=True) for word in words.split()}
_SMALL_WORDS = (
    "mon tue tues wed thu thur thurs fri sat sun monday tuesday wednesday thursday friday saturday sunday",
    "mo di mi do fr sa so montag dienstag mittwoch donnerstag freitag samstag sonntag",
    "lun mer gio ven sab dom lunedì martedì mercoledì giovedì venerdì sabato domenica",
    "jeu sam dim lundi mardi mercredi jeudi vendredi samedi dimanche",
    "mié mie jue vie sáb lunes martes miércoles jueves viernes sábado domingo",
    "uhr at um alle ore à le il de del of am klo kl ob godz",
)
"""Days of the week and small words, which the date says again. `am` is German here: after digits it halves a day."""
_DROPPED = frozenset(word for words in _SMALL_WORDS for word in words.split())
_HALF = re.compile(r"(?<=\d)\s*([ap])\s?\.?\s?m\b\.?", re.IGNORECASE)
_ASIDE = re.compile(r"\s*\([^)]*\)\s*$")
_NO_ZONE = re.compile(r"\b(?:GMT|UTC|Z)(?=[+-]\d)")
_ZONES = {
    "GMT": "+0000", "UTC": "+0000", "WET": "+0000", "WEST": "+0100", "CET": "+0100", "CEST": "+0200", "MEZ": "+0100",
    "MESZ": "+0200", "EET": "+0200", "EEST": "+0300", "EST": "-0500", "EDT": "-0400", "CDT": "-0500", "MST": "-0700",
    "MDT": "-0600", "PST": "-0800", "PDT": "-0700",
}  # fmt: skip
"""Zones that have one meaning: CST is of Chicago and of Shanghai, IST and BST are of three each."""
_ZONE = re.compile(rf"\s*\b({'|'.join(_ZONES)})(?=$| \d{{4}}$)")
_WALL_ZONE = re.compile(r"\s+(?:CT|ET|MT|PT)$")
"""A zone's name that says neither its offset nor its half of the year: the time is a local one."""
_COUNTED_DATE = re.compile(r"(\d{4})[年년]\s*(\d\d?)[月월]\s*(\d\d?)[日일]")
_FRAME = re.compile(r"^(?:\[|DT#|DATE_AND_TIME#)|\]$")
"""What web servers and controllers write around a time."""
_HOURS = re.compile(r"(?<!\d)(\d\d?) ?h ?(\d\d)(?: ?(?:min|m|:) ?(\d\d) ?s?|(?: ?(?:min|m))?(?![\d:]))", re.IGNORECASE)
"""21h17, 21h17m00s."""
_HALF_BEFORE = re.compile(r"(?:(上午|午前|오전)|下午|午後|오후)\s*(\d[\d:.]*)")
_LOCAL_HALVES = {
    "π.μ.": "AM", "πμ": "AM", "μ.μ.": "PM", "μμ": "PM", "ص": "AM", "م": "PM", "f.m.": "AM", "fm": "AM", "e.m.": "PM",
    "em": "PM", "öö": "AM", "ös": "PM", "dop.": "AM", "odp.": "PM", "vorm.": "AM", "nachm.": "PM", "de.": "AM",
    "du.": "PM",
}  # fmt: skip
"""Halves of the day in Greek, Arabic, Swedish, Turkish, Czech, German and Hungarian, the last before its time."""
_HALF_BEHIND = re.compile(rf"(?<=\d)\s*({'|'.join(map(re.escape, _LOCAL_HALVES))})$", re.IGNORECASE)
_HALF_IN_FRONT = re.compile(r"\b(d[eu]\.)\s*(\d\d?:[\d:.]*\d)$", re.IGNORECASE)
_SPACED_DATE = re.compile(r"^(\d{1,4})\. ?(\d\d?)\. ?(\d{1,4})\.?(?=\s|$)")
"""13. 3. 2024 and 2024. 03. 13., as Czech and Hungarian programs write them."""
_NEEDLESS_HALF = re.compile(r"(?<= )(0?0(?=[:\d.,]+ A)|(?:1[3-9]|2[0-3])(?=[:\d.,]+ P))(:[\d:.,]+) [AP]M\b")
"""AM or PM behind an hour of 24, as Niagara writes it; one that contradicts its hour is read as nothing."""
_WORD = re.compile(r"[^\W\d_]{2,}\.?|\bà\b")
_YEAR_LAST = re.compile(r"^([A-Z][a-z]{2} \d\d?),? (\d\d?:\d\d(?::\d\d(?:\.\d+)?)?(?: [AP]M)?)( [+-]\d{4})? (\d{4})$")
_ORDINAL = re.compile(r"(?<=\d)(?:\.(?=\s*[^\W\d_])|(?:st|nd|rd|th|er|º|ª)\b)")


def plain_time(text: str) -> str:
    """A time with English months of three letters, AM or PM and an offset, as strptime reads them: no other words.

    "Wed Mar 13 2024 09:58:00 GMT+0100 (Central European Standard Time)" is "Mar 13 2024 09:58:00 +0100", and
    "13. Mrz 2024 09:58:00" is "13 Mar 2024 09:58:00". A year behind the time comes before it.
    """
    text = _COUNTED_DATE.sub(r"\1-\2-\3", _WALL_ZONE.sub("", _FRAME.sub("", text.rstrip())))
    text = _SPACED_DATE.sub(r"\1.\2.\3", text)
    text = _HALF_IN_FRONT.sub(lambda match: f"{match[2]} {_LOCAL_HALVES[match[1].casefold()]}", text)
    text = _HALF_BEHIND.sub(lambda match: f" {_LOCAL_HALVES[match[1].casefold()]}", text)
    text = _HOURS.sub(lambda match: ":".join(filter(None, match.groups())), text)
    text = _HALF_BEFORE.sub(lambda match: f"{match[2]} {'AM' if match[1] else 'PM'}", text)
    text = _ZONE.sub(lambda match: f" {_ZONES[match[1]]}", _NO_ZONE.sub("", _ASIDE.sub("", text.strip())))
    text = _NEEDLESS_HALF.sub(r"\1\2", _HALF.sub(lambda match: f" {match[1].upper()}M", text))
    text = _ORDINAL.sub("", text)
    months = sum(word[0].rstrip(".").casefold() in _MONTH for word in _WORD.finditer(text))

    def word(match: re.Match[str]) -> str:
        nonlocal months
        found = match[0].rstrip(".").casefold()
        if found in _MONTH:
            months -= 1
            # The first of two is a day of the week: mar. 12 mar. 2024.
            return "" if months else _MONTH[found]
        return "" if found in _DROPPED and match[0] != "AM" else match[0]

    plain = " ".join(_WORD.sub(word, text).split()).lstrip(",. ")
    # C's asctime has the year behind the time.
    return _YEAR_LAST.sub(r"\1 \4 \2\3", plain)


def wall_zone(text: str) -> str:
    """The zone's name at the end of a time that says no offset, CT or ET; "" for none."""
    match = _WALL_ZONE.search(text.rstrip())
    return match[0].strip() if match else ""
