"""What columns are called in plants' exports, in English, Italian, German, French and Spanish: parts, times, units."""

import re

from sim.lab.recordings.unit_table import UNITS, known_unit

# A word begins or ends where the case changes or no letter stands: TCuscinetti, T_brg_1, motor.current.
_TEMPERATURE = re.compile(
    r"temp(?!o\b|s\b)|°c|degc|thermo|^t_|_t$|^t(?=[A-Z\d])|\bt\d|_temp|^tt?[-_]?\d|tempér|coolant|warm|wärme",
    re.IGNORECASE,
)
_BEARING = re.compile(r"bearing|brg|cuscinett|lager|palier|roulement|rodamiento|cojinete", re.IGNORECASE)
_NOT_BEARING = re.compile(
    r"amb|outside|outdoor|aussen|außen|esterna|extérieur|exterior|intake|room|raum|setpoint|sollwert|\bsp\b|limit|"
    r"alarm|soglia|grenz|consigne|fluid|feed|oil|öl|olio|huile|aceite|water|wasser",
    re.IGNORECASE,
)
_CURRENT = re.compile(
    r"current|strom(?!ung)|corrente|corriente|courant|intensit|assorb|amp(?!l)|\bi[_ ]|^i\d|_i$|_i_|stromaufn",
    re.IGNORECASE,
)
_RUNNING = re.compile(
    r"run|running|marcia|betrieb|läuft|lauf|marche|marcha|motor.?on|in_?funzione|started|_on\b|_ein\b|on_?off|ein.?aus|status|"
    r"stato|état|estado|zustand|servizio",
    re.IGNORECASE,
)
_ALARM = re.compile(r"alarm|allarm|fault|stör|guasto|défaut|fallo|error|quality|qualit|valid", re.IGNORECASE)
_TIME = re.compile(
    r"time|zeit|datum|date|data\b|\bora\b|tempo\b|heure|horodat|temps|fecha|hora|stamp|\bt\b|\bts\b|clock|epoch|\bsec",
    re.IGNORECASE,
)
_NAME = re.compile(
    r"^(?:.*(?:name|tag|variable|field|point|signal|series|metric|parameter|channel|messstelle|nome|nom|nombre|bezeichn|"
    r"punto|sensor|item).*)$",
    re.IGNORECASE,
)
_VALUE = re.compile(
    r"^_?(?:var|v|tag|num|float|int|process|raw)?_?(?:value|wert|valore|valeur|valor|val|reading|messwert)s?"
    r"(?:[ _\[(].*)?$",
    re.IGNORECASE,
)
_BRACKETED = re.compile(r"\s*[\[({]\s*([^\])}]*)\s*[\])}]\s*$")
_IN_NAME = re.compile(r"[_ .](degC|°C|rpm|kW|bar|mA|A|V|C)$")


def bare_unit(cell: str) -> str:
    """A unit as it is written, without brackets, in lower case."""
    return cell.strip().strip("[](){}").strip().casefold()


def unit_of(header: str) -> tuple[str, str]:
    """(header without its unit, unit): "T bearing [°C]" is ("T bearing", "degC"); no unit that is known: ""."""
    match = _BRACKETED.search(header)
    if match:
        unit = UNITS.get(match[1].casefold().strip(), "")
        return (header[: match.start()].strip(), unit) if unit or not match[1].strip() else (header, "")
    match = _IN_NAME.search(header)
    return (header, UNITS.get(match[1].casefold(), "")) if match else (header, "")


def temperature_score(name: str, unit: str) -> int:
    """How much a column's name and unit say that it is the temperature to be modelled; 0: nothing."""
    of_unit = 2 if unit in ("degC", "degF") else 0
    if unit and not of_unit and unit != "K":
        return 0
    of_name = 2 if _TEMPERATURE.search(name) else 0
    if not of_unit + of_name:
        return 0
    return max(of_unit + of_name + (4 if _BEARING.search(name) else 0) - (3 if _NOT_BEARING.search(name) else 0), 1)


def current_score(name: str, unit: str) -> int:
    """The same for the motor's current."""
    if unit and unit not in ("A", "mA"):
        return 0
    return (3 if unit in ("A", "mA") else 0) + (2 if _CURRENT.search(name) else 0)


def running_score(name: str) -> int:
    """The same for the switch that says whether the machine runs."""
    return 0 if _ALARM.search(name) else 2 if _RUNNING.search(name) else 0


def named_time(name: str) -> bool:
    """Whether a header speaks of time."""
    return _TIME.search(name) is not None


def named_name(name: str) -> bool:
    """Whether a header speaks of names of signals, as in a long file."""
    return _NAME.match(name) is not None


def named_value(name: str) -> bool:
    """Whether a header speaks of a value, as in a long file."""
    return _VALUE.match(name) is not None


def day_first(names: str) -> bool:
    """Whether headers are in a language of a country that writes the day before the month."""
    words = (
        r"zeit|datum|wert|ora\b|valore|marcia|cuscinett|corrente|heure|horodat|valeur|courant|fecha|valor|temperatura"
    )
    return re.search(words, names, re.IGNORECASE) is not None
