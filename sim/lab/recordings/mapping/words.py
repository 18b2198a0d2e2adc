"""What columns are called in plants' exports, in five languages of Europe and in Chinese: parts, times, units."""

import re
from collections.abc import Callable, Iterable, Mapping

from sim.lab.recordings import CONVERTED_UNITS, known_unit

# A word begins or ends where the case changes or no letter stands: TCuscinetti, T_brg_1, motor.current. TI101, II101,
# JI101
# and SI101 are a temperature, a current, a power and a speed by ISA 5.1.
_TEMPERATURE = re.compile(
    r"temp(?!o\b|s\b)|°c|degc|celsius|thermo|(?:^|[:./ ])t[iet]?[ctr]?_|_t$|"
    r"(?-i:^T(?=[A-Z][a-z]|\d|_|BRG|BEA|LAG|CUSC|PAL))|\bt\d|_temp|"
    r"(?:^|[:./_-])t[iet]?[ctr]?[-_]?\d|tempér|coolant|warm|wärme|温度",
    re.IGNORECASE,
)
_DEGREES = re.compile(r"temp(?!o\b|s\b)|tempér|thermo|温度", re.IGNORECASE)
_BEARING = re.compile(r"bearing|brg|cuscinett|lager|palier|roulement|rodamiento|cojinete|轴承", re.IGNORECASE)
_SURROUNDINGS = re.compile(
    r"amb|outside|outdoor|aussen|außen|umgebung|hallen|esterna|extérieur|exterior|intake|room|raum|setpoint|sollwert|\bsp\b|limit|"
    r"alarm|soglia|grenz|consigne|室外|环境|设定",
    re.IGNORECASE,
)
"""A temperature of what stands around a machine, or one that nobody measured."""
_MEDIUM = re.compile(r"fluid|feed|(?<![bcfs])oil|öl|olio|huile|aceite|water|wasser|油|水", re.IGNORECASE)
"""A temperature of what flows through a machine: not a bearing's, but a boiler's own; a boiler is no oil."""
_CURRENT = re.compile(
    r"(?:^|[:./_-])i[it][-_]?\d|(?:^|[:./ ])i[it]_|"
    r"current|strom(?!ung)|corrente|corriente|courant|intensit|assorb|\bi[_ ]|^i\d|_i$|_i_|stromaufn|电流|電流|"
    # Amperes, but no campus, lamp or damper.
    r"motoramps|milliamp|(?-i:(?<![A-Za-z])[Aa]mp(?:s|[eè]res?)?(?![a-z])|(?<=[a-z])Amp(?:s|eres?)?(?![a-z])|"
    r"(?<![A-Z])AMP(?:S|ERES?)?(?![A-Z]))",
    re.IGNORECASE,
)
_RUNNING = re.compile(
    r"run|running|marcia|betrieb|läuft|lauf|marche|marcha|motor.?on|in_?funzione|started|_on\b|_ein\b|on_?off|ein.?aus|status|"
    r"stato|état|estado|zustand|servizio|運転|稼働|运行",
    re.IGNORECASE,
)
_ALARM = re.compile(r"alarm|allarm|fault|stör|guasto|défaut|fallo|error|quality|qualit|valid", re.IGNORECASE)
_TIME = re.compile(
    r"time|elapsed|^x_value$|^t_(?:ms|s|sec|min|h)$|zeit|datum|date|data\b|\bora\b|tempo\b|heure|horodat|temps|fecha|hora|stamp|\bt\b|\bts\b|clock|epoch|\bsec|时间|日期|"
    r"\btid\b|tidspunkt|klock|klokk|\baika\b|\bčas\b|\bczas\b|godzin|tijd|tarih|\bsaat|zaman|\bidő|dátum|"
    r"врем|дата|ώρα|ημερομ|日付|日時|時刻|시간|날짜|일시",
    re.IGNORECASE,
)
_DURATION = re.compile(
    r"(?:run|running|operating|cycle|up|down)[ _-]?time|duration|elapsed|laufzeit|betriebs(?:zeit|dauer)|dauer\b|"
    r"(?:zyklus|takt)zeit|durata|tempo[ _]?(?:di[ _])?ciclo|dur[ée]e|temps[ _]de[ _]cycle|duraci[óo]n|"
    r"tiempo[ _]de[ _]ciclo|时长",
    re.IGNORECASE,
)
_DAY = re.compile(r"date|datum|data|fecha|day|tag|giorno|jour|d[ií]a|日期", re.IGNORECASE)
_FREQUENCY = re.compile(r"[\[({_ ][kMG]?Hz[\])}]?(?:_\d+)?\s*$", re.IGNORECASE)
"""The end of a header that says hertz: the clock of a processor is a frequency."""
_NAME = re.compile(
    r"^(?:.*(?:name|tag|variable|field|point|signal|series|metric|parameter|channel|entity|alias|property|measurement|messstelle|nome|nom|nombre|bezeichn|"
    r"punto|sensor|item|path|topic|target|node.?id|descri|beschreib|label|libell).*)$",
    re.IGNORECASE,
)
_KIND = "num|float|int|integer|bigint|bool|boolean|dbl|double|real|str|string|text"
_VALUE = re.compile(
    rf"^(?:_?(?:var|v|tag|measure|process|raw|date|{_KIND})?_?"
    rf"(?:value|wert|valore|valeur|valor|val|reading|messwert|payload)s?(?:::)?(?:{_KIND})?(?:[ _\[(].*)?|"
    # What stands within a value by its type.
    rf"value\.(?:body|(?:{_KIND})value))$",
    re.IGNORECASE,
)
_BRACKETED = re.compile(r"\s*[\[({]\s*([^\])}]*)\s*[\])}]\s*$")
_FIELDS = re.compile(r"\[([^\[\]]+)\]\s*\[([^\[\]]*)\]\s*(?:\[[^\[\]]*\])")
"""Name, unit and number, each in brackets of its own."""
_IN_NAME = re.compile(
    r"(?:[_ .,;:/]|(?<=[_ ])in )(?P<unit>(?i:(?:deg|grad)[ _]?[CF]|kelvin|celsius|fahrenheit)|[°º]\s?[CFK]|℃|"
    r"[Aa]mp(?:s|eres?)?|rpm|[kM]?W|m?bar|kPa|"
    r"[mk]?A|k?V|Nm|Hz|%|[CFK])$"
)
_DEGREE_MARKS = frozenset("°º℃℉")
_TEMPERATURE_LETTER = re.compile(
    r"temp(?:erature?|eratura)?(?P<ending>(?:_?(?:deg|grad)|[_ ])?_?(?P<letter>[cf]))$",
    re.IGNORECASE,
)
"""temp_c, TempC, tempDegF: a letter at the end of a temperature's name."""
_DEGREE_SIGN = re.compile(r"\s+(?P<unit>[°º]\s?[CF]|℃|℉)(?=\s+(?!per\b|pro\b|par\b)[^\W\d]{2})")
"""A unit with more words behind it, such as the place's."""
_LOAD = re.compile(
    r"(?:^|[:./_-])[js][it][-_]?\d|power|leist|potenza|potencia|puissance|load|last\b|carico|carga|charge|speed|rpm|drehzahl|velocit|giri|vitesse|torque|"
    r"moment|coppia|couple|frequen|throttle|功率|负荷|负载|转速|频率",
    re.IGNORECASE,
)
_SENSED = re.compile(
    r"(?:^|[^a-z])o2|oxygen|sauerstoff|ossigeno|oxyg[eè]ne|ox[ií]geno|lambda|λ|sonde\b|sonda\b|probe|\bnox\b|4.?-.?20|"
    r"transmitter|[\[({_ ](?-i:[µμun]A)\b|氧|探头",
    re.IGNORECASE,
)
"""A sensor whose own current is its reading; no machine draws microamperes."""
_REMAINDER = re.compile(
    r"\brest\b|_rest\b|rest[-_]of|remain(?!ing)|residual|\bother|\bmisc\b|übrig|sonstig|altr[oi]\b|autres?\b|otr[oa]s\b|其他|其余",
    re.IGNORECASE,
)
_TOTAL = re.compile(
    r"total|overall|(?:^|[^a-z])sum(?![a-z])|summe|gesamt|insgesamt|somma|totale|complessiv|somme|suma\b|总",
    re.IGNORECASE,
)
_SETPOINT = re.compile(
    r"set.?point|sollwert|\bsp\b|consigne|soglia|limit|target|alarm|threshold|schwelle|seuil|umbral|ref\b|设定",
    re.IGNORECASE,
)
_COUNT = re.compile(
    r"hours|stunden|\bore\b|contaore|heures|horas|counter|\bcounts?\b|zähler|zaehler|contatore|compteur|contador",
    re.IGNORECASE,
)
"""What counts hours or pieces: it goes on rising, and says of no moment whether the machine runs."""
_FEED = re.compile(r"feed|zulauf|ingresso|alimentazion|fango|slurry|entrada", re.IGNORECASE)
_AMBIENT = re.compile(
    r"ambient|(?:^|[^a-z])amb(?![a-z])|outside|outdoor|aussen|außen|umgebung|hallen|esterna|extérieur|exterior|"
    r"(?:^|[^a-z])room|raum|室外|环境",
    re.IGNORECASE,
)
_OF_OTHER_PARTS = re.compile(
    r"water|wasser|acqua|\beau\b|oil|öl|olio|huile|cool|kühl|raffredd|motor|winding|wickl|pump|control|panel|cabinet|"
    r"schalt|schrank|quadro|armoire",
    re.IGNORECASE,
)
"""What is neither a machine's feed nor what stands around it, whatever else the name says."""
_VIBRATION = re.compile(r"vibra|schwing", re.IGNORECASE)
LOAD_UNITS = frozenset({"W", "kW", "MW", "rpm", "Nm", "Hz"})
"""Units of what loads a machine, besides those of a current."""
_STANDSTILL = re.compile(
    r"stand.?still|still.?stand|\bstop|stopped|_stop|gestoppt|fermo|fermat|arr[eê]t|parad[ao]|\bidle|\bhalt\b|not.?running|"
    r"\boff\b|_off$|spento",
    re.IGNORECASE,
)
_STATE = re.compile(r"stat[eo]|status|zustand|état|estado|mode|modus|phase|fase|packml|betriebsart", re.IGNORECASE)
_SESSION = re.compile(
    r"session|profile|profil|run|batch|charge|lot\b|lotto|test|experiment|trial|cycle|zyklus|ciclo", re.IGNORECASE
)
_MACHINE = re.compile(
    r"machine|maschine|macchina|turbin|unit|asset|equipment|device|gerät|anlage|impianto|\bid\b|_id$|number|nummer|"
    r"numero|station|site|plant|pump|motor|line|serial|vehicle|engine|transformer|name",
    re.IGNORECASE,
)
_SURELY = re.compile(
    r"(?:machine|maschine|macchina|turbine|asset|equipment|device|gerät|vehicle)"
    r"(?:[ _.-]?(?:id|name|no|nr|number|nummer|numero|tag|code))?$|"
    r"serial(?:[ _.-]?(?:no|nr|number|nummer))?$|(?:unit|engine|pump|motor)[ _.-]?id$",
    re.IGNORECASE,
)
"""Of whom the rows are; the speed of a vehicle and the battery of a device are readings."""
_OF_PART = re.compile(r"\bstep|[-_ ]cyc|\bcycle|\blap\b|schritt|zyklus", re.IGNORECASE)
_UNIT_COLUMN = re.compile(
    r"^(?:.*\.)?(?:unit|units|unit_of_measurement|einheit|unit[àa]|unité|unidad|uom|eu|engunits?)$", re.IGNORECASE
)


def bare_unit(cell: str) -> str:
    """A unit as it is written, without brackets, in lower case."""
    return cell.strip().strip("[](){}").strip().casefold()


def split_unit(header: str, beside: Iterable[str] = ()) -> tuple[str, str]:
    """(header without its unit, unit): "T bearing [°C]" is ("T bearing", "degC"); no unit that is known: "".

    `beside` are the other headers: temp_c is no degC beside temp_a.
    """
    if fields := _FIELDS.fullmatch(header.strip()):
        return fields[1].strip(), known_unit(fields[2])
    match = _BRACKETED.search(header)
    if match:
        unit = known_unit(match[1])
        bare = header[: match.start()].strip()
        # "[Bearing temperature][°C]": the name in brackets of its own.
        if bare.startswith("[") and bare.endswith("]"):
            bare = bare[1:-1].strip()
        if bare and (unit or not match[1].strip()):
            return bare, unit
        # "Temp, °F (LGR S/N: 10012)": what stands in brackets behind the unit says whose it is.
        before = _IN_NAME.search(bare)
        unit = known_unit(before["unit"]) if before and before["unit"][:1] in _DEGREE_MARKS else ""
        return (f"{bare[: before.start()]} {match[0].strip()}", unit) if before and unit else (header, "")
    if _is_lettered(header, beside):
        return header, ""
    match = _IN_NAME.search(header)
    if match is None and (match := _TEMPERATURE_LETTER.search(header)):
        unit = known_unit(f"deg {match['letter']}")
        return header[: match.start("ending")] if unit in CONVERTED_UNITS else header, unit
    if match is None and (match := _DEGREE_SIGN.search(header)):
        unit = known_unit(match["unit"])
        return header[: match.start()] + header[match.end() :] if unit in CONVERTED_UNITS else header, unit
    unit = known_unit(match["unit"]) if match else ""
    # Temperature A and Temperature V are the first and the fifth, not amperes and volts.
    if match is None or (unit in ("A", "V") and _TEMPERATURE.search(header)):
        return header, ""
    # A unit that the map converts must not stay in the signal's name.
    return header[: match.start()] if unit in CONVERTED_UNITS and unit != CONVERTED_UNITS[unit] else header, unit


def _is_lettered(header: str, beside: Iterable[str]) -> bool:
    """Whether a temperature's name ends in a letter as those of several places do."""
    units = "cfk"
    if header[-1:].casefold() not in units or not _DEGREES.search(header):
        return False
    letters = (other[-1:].casefold() for other in beside if other[:-1] == header[:-1])
    return any(letter.isalpha() and letter not in units for letter in letters)


def temperature_score(name: str, unit: str) -> int:
    """How much a column's name and unit say that it is the temperature to be modelled; 0: nothing."""
    of_unit = 2 if unit in ("degC", "degF", "K") else 0
    if unit and not of_unit:
        return 0
    of_name = 2 if _TEMPERATURE.search(name) else 0
    if not of_unit + of_name:
        return 0
    least = 1 if named_surroundings(name) else 2
    other = least == 1 or _MEDIUM.search(name)
    return max(of_unit + of_name + (4 if named_bearing(name) else 0) - (3 if other else 0), least)


def named_bearing(name: str) -> bool:
    """Whether a column's name speaks of a bearing."""
    return _BEARING.search(name) is not None


def named_surroundings(name: str) -> bool:
    """Whether a temperature's name speaks of what stands around the machine, or of one that is not measured."""
    return _SURROUNDINGS.search(name) is not None


def _measured_aside(name: str, unit: str) -> bool:
    """Whether it is a temperature that is measured, and no bearing's."""
    of_degrees = unit in ("degC", "degF", "K") or (not unit and _TEMPERATURE.search(name) is not None)
    others = (_SETPOINT, _ALARM, _OF_OTHER_PARTS)
    return of_degrees and not (named_bearing(name) or any(words.search(name) for words in others))


def _plays_ambient(name: str, unit: str) -> bool:
    return _measured_aside(name, unit) and _AMBIENT.search(name) is not None


def _plays_feed(name: str, unit: str) -> bool:
    return _measured_aside(name, unit) and _FEED.search(name) is not None


def _plays_vibration(name: str, unit: str) -> bool:
    return unit in ("", "mm/s") and _VIBRATION.search(name) is not None and not _SETPOINT.search(name)


ROLE_WORDS: Mapping[str, Callable[[str, str], bool]] = {
    "ambient": _plays_ambient,
    "feed": _plays_feed,
    "vibration": _plays_vibration,
}
"""Roles besides the load's that a column's name and unit may say (`decanter diagnose`)."""


def current_score(name: str, unit: str) -> int:
    """The same for the motor's current; a sensor's own is none."""
    # The current temperature is the one of now.
    if (unit and unit not in ("A", "mA", "kA")) or (not unit and _DEGREES.search(name)) or _SENSED.search(name):
        return 0
    return (3 if unit in ("A", "mA", "kA") else 0) + (2 if _CURRENT.search(name) else 0)


def named_current(name: str) -> bool:
    """Whether a name says current, whatever its unit."""
    return _CURRENT.search(name) is not None


def named_remainder(name: str) -> bool:
    """Whether a load's name says that it is what is left beside others."""
    return _REMAINDER.search(name) is not None


def named_total(name: str) -> bool:
    """Whether a load's name says that others are parts of it."""
    return _TOTAL.search(name) is not None


def named_otherwise(name: str, other: str) -> bool:
    """Whether `name` says set point, alarm, total or count, and `other`, which it may be another name of, does not."""
    return any(word.search(name) and not word.search(other) for word in (_SETPOINT, _ALARM, _TOTAL, _COUNT))


def running_score(name: str) -> int:
    """The same for the switch that says whether the machine runs."""
    return 0 if _ALARM.search(name) or named_duration(name) else 2 if _RUNNING.search(name) else 0


def load_score(name: str, unit: str) -> int:
    """The same for anything else that loads the machine: power, speed, torque."""
    if (unit and unit not in LOAD_UNITS and unit != "%") or _SETPOINT.search(name):
        return 0
    return 3 * (unit in LOAD_UNITS) + 2 * bool(_LOAD.search(name))


def named_standstill(name: str) -> bool:
    """Whether a switch of this name is on while the machine stands still."""
    return _STANDSTILL.search(name) is not None


def named_state(name: str) -> bool:
    """Whether a header speaks of states of a machine."""
    return _STATE.search(name) is not None and not _ALARM.search(name)


def named_session(name: str) -> bool:
    """Whether a header speaks of sessions of one machine."""
    return _SESSION.search(name) is not None


def named_machine(name: str) -> bool:
    """Whether a header speaks of machines."""
    return _MACHINE.search(name) is not None


def surely_machine(name: str) -> bool:
    """Whether a header speaks of machines and of nothing else."""
    return _SURELY.search(name) is not None


def named_unit(name: str) -> bool:
    """Whether a header speaks of units, as in a long file."""
    return _UNIT_COLUMN.match(name.strip()) is not None


def named_time(name: str) -> bool:
    """Whether a header speaks of time."""
    return _TIME.search(name) is not None and not _FREQUENCY.search(name)


def named_duration(name: str) -> bool:
    """Whether a header speaks of how long something took, which is no time of day."""
    return _DURATION.search(name) is not None


def named_day(name: str) -> bool:
    """Whether a header says date and nothing else."""
    return _DAY.fullmatch(name.strip()) is not None


def named_part_time(name: str) -> bool:
    """Whether a time is that of a part of the recording, a step or a cycle, and begins anew with each."""
    return _OF_PART.search(name) is not None


def named_entity(name: str) -> bool:
    """Whether a header speaks of a home automation's entities, whose readings are called states."""
    return name.casefold() in ("entity_id", "entity")


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
