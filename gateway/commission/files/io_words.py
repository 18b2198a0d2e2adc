"""The words of I/O lists in Italian, English, German, French and Spanish: columns, types, orders and tables.

Every word of a cell is understood or the row is refused: a word that is dropped may have said the order.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "no_scale": (),  # by --column alone: what looks like scales and is none
    "name": (
        *("tag", "tag name", "tagname", "nome tag", "nome", "name", "sigla", "variabile", "variable", "segnale"),
        *("signal", "simbolo", "symbol", "nome variabile", "nome segnale", "etichetta", "item", "punto", "point"),
        *("variablenname", "signalname", "messstelle", "datenpunkt", "kennzeichen", "nom", "nom de variable"),
        *("nom du signal", "repere", "mnemonique", "nombre", "nombre de variable", "senal", "simbolo", "bezeichnung"),
        *("designation", "naam", "nazwa", "title", "titel", "titolo", "titre", "titulo"),
    ),
    "address": (
        *("indirizzo", "address", "indirizzo modbus", "modbus address", "registro", "register", "addr", "ind"),
        *("indirizzo plc", "plc address", "modbus register", "registro modbus", "offset modbus", "nodeid", "object"),
        *("oggetto", "index", "indice", "reg no", "reg nr", "reg number", "modbus reg"),
        *(
            "adresse registre",
            "adresse du registre",
            "adresse",
            "modbus adresse",
            "registeradresse",
            "registernummer",
            "adresse modbus",
            "registre",
        ),
        *("direccion", "direccion modbus", "endereco", "endereco modbus", "adres", "adres modbus"),
        *("protocol offset", "protocol address", "pdu offset", "pdu address", "register offset", "address offset"),
    ),
    "end": (
        *("end address", "address end", "addr end", "end addr", "end register", "register end", "last register"),
        *("last address", "to address", "address to", "stop address", "endadresse", "adresse ende", "bis adresse"),
        *("indirizzo finale", "fine indirizzo", "ultimo registro", "adresse fin", "adresse de fin", "dernier registre"),
        *("direccion final", "ultimo registro"),
    ),
    "table": (
        *("area", "tabella", "table", "tipo registro", "register type", "tipo di registro", "memory area"),
        *("area di memoria", "funzione", "function", "function code", "codice funzione", "object type"),
        *("registertyp", "registerart", "speicherbereich", "funktion", "funktionscode", "type de registre"),
        *("zone memoire", "fonction", "code fonction", "tabla", "funcion", "codigo de funcion"),
    ),
    "dtype": (
        *("tipo dato", "tipo di dato", "data type", "datatype", "tipo", "type", "formato", "format", "dtype"),
        *("tipo variabile", "variable type"),
        *("datentyp", "typ", "datenformat", "type de donnee", "type de donnees", "tipo de dato", "tipo de datos"),
        *("formato de dato", "tipo de dado", "tipo de dados", "gegevenstype", "typ danych"),
    ),
    "order": (
        *("ordine", "order", "byte order", "word order", "ordine word", "ordine parole", "ordine byte", "endianness"),
        *("swap", "byte word order", "endian"),
        *("wortfolge", "wortreihenfolge", "bytefolge", "byte reihenfolge", "bytereihenfolge", "ordre"),
        *("ordre des mots", "ordre des octets", "orden", "orden de palabras", "orden de bytes"),
    ),
    "bit": (
        *("bit", "n bit", "numero bit", "bit number", "posizione bit"),
        *("bitnummer", "bit nr", "numero de bit"),
    ),
    "count": (
        *("quantity", "qty", "registers", "number of registers", "no of registers", "n registers", "register count"),
        *("words", "word count", "word span", "register span", "numero registri", "numero di registri"),
        *("n registri", "no of words", "num registers"),
        *("anzahl register", "registeranzahl", "anzahl", "nombre de registres", "nb registres"),
        *("numero de registros", "cantidad de registros", "cantidad"),
    ),
    "length": (
        *("lunghezza", "length", "len", "byte", "bytes", "caratteri"),
        *("lange", "longueur", "longitud", "size", "data size", "bits", "bit length", "no of bits", "data length"),
        *("grosse", "groesse", "datenlange", "bitlange", "dimensione", "taille", "tamano"),
    ),
    "scale": (
        *("scala", "scale", "fattore", "factor", "fattore di scala", "scale factor", "scaling", "moltiplicatore"),
        *("multiplier", "gain", "guadagno", "risoluzione", "resolution", "k", "coefficiente", "ratio"),
        *("divisor", "divider", "divisore", "divide by", "teiler"),
        *("skalierung", "faktor", "skalierungsfaktor", "auflosung", "echelle", "facteur", "facteur d echelle"),
        *("escala", "factor de escala", "diviseur", "resolucion", "fator", "fator de escala", "schaal", "mnoznik"),
    ),
    "decimals": (
        *("decimals", "decimal places", "decimali", "cifre decimali", "number of decimals", "decimal digits"),
        *("exponent", "esponente", "scale exponent"),
        *("nachkommastellen", "dezimalstellen", "decimales", "anzahl nachkommastellen", "anzahl dezimalstellen"),
        *("kommastellen", "cantidad de decimales", "nombre de decimales"),
    ),
    "range": (
        *("range", "campo", "intervallo", "value range", "wertebereich", "span", "campo di valori"),
        *("messbereich", "plage", "plage de valeurs", "rango", "intervalo", "min max", "min to max", "low high"),
    ),
    "offset": (
        *("offset", "scostamento", "zero"),
        *("versatz", "nullpunkt", "decalage", "desplazamiento"),
    ),
    "unit": (
        *("unita", "unita di misura", "unita misura", "um", "u m", "unit", "units", "ing unit", "eng unit"),
        *("engineering unit", "engineering units", "eu", "udm", "u d m", "misura"),
        *("einheit", "physikalische einheit", "unite", "unidad", "unidad de medida", "unidades", "unites", "einheiten"),
        *("unidade", "eenheid", "jednostka"),
    ),
    "formula": ("formula", "formel", "espressione", "expression"),
    "unit_id": (
        *("deviceid", "device id", "slave", "slave id", "slave address", "unit id", "modbus id", "slaveid"),
        *("unit address", "unit number", "unit no", "modbus unit", "unit identifier"),
        *("adresse esclave", "esclave", "no esclave", "numero esclave"),
    ),
    "negate": ("negate value", "negate"),
    "raw_low": (
        *("raw min", "min raw", "grezzo min", "min grezzo", "raw low", "inizio scala raw", "count min"),
        *("raw zero", "raw lo", "raw value min", "raw value low", "low raw", "raw lower"),
    ),
    "raw_high": (
        *("raw max", "max raw", "grezzo max", "max grezzo", "raw high", "fondo scala raw", "count max"),
        *("raw full", "raw hi", "raw value max", "raw value high", "high raw", "raw upper"),
    ),
    "low": (
        *("min", "minimo", "minimum", "low", "eng min", "min eng", "min ing", "ing min", "inizio scala"),
        *("range min", "limite inferiore", "eu min", "lo", "lrv", "lower range", "lower range value"),
        *("eng zero", "eu zero", "range lower", "range from", "messbereich anfang", "messbereichsanfang"),
        *("min wert", "minwert", "untergrenze", "mini", "valeur min", "valor minimo"),
    ),
    "high": (
        *("max", "massimo", "maximum", "high", "eng max", "max eng", "max ing", "ing max", "fondo scala"),
        *("range max", "limite superiore", "eu max", "hi", "urv", "upper range", "upper range value"),
        *("eng full", "eu full", "range upper", "range to", "messbereich ende", "messbereichsende"),
        *("max wert", "maxwert", "obergrenze", "maxi", "maximo", "valeur max", "valor maximo"),
    ),
    "sentinel": (
        *("sentinella", "sentinel", "non disponibile", "not available", "valore guasto", "fault value", "na"),
        *("fehlerwert", "ersatzwert", "valeur de defaut", "valor de fallo"),
        *("invalid", "invalid value", "value if invalid", "error value", "bad value", "null value", "no value"),
        *("nan value", "unavailable", "unavailable value", "value not available", "not implemented", "unimplemented"),
        *("undefined", "undefined value", "ungultig", "ungultiger wert", "valore non valido", "valeur invalide"),
        *("valor invalido",),
    ),
    "access": (
        *("accesso", "access", "r w", "rw", "lettura scrittura", "read write", "permessi", "direzione"),
        *("zugriff", "lesen schreiben", "acces", "lecture ecriture", "acceso", "lectura escritura"),
    ),
    "remark": (
        *("descrizione", "commento", "note", "notes", "description", "comment", "remark", "remarks", "bemerkung"),
        *("beschreibung", "kommentar", "commentaire", "remarque", "descripcion", "comentario", "observaciones"),
    ),
}
"""Column -> the headers by which it is recognised, as `cells.header_key` writes them; the first that fits wins."""

LENGTHS_IN_BITS = frozenset({"bits", "bit length", "no of bits", "bitlange"})
LENGTHS_OF_NO_UNIT = frozenset({"size", "data size", "grosse", "groesse", "dimensione", "taille", "tamano"})
"""A number's width shows which unit such a length has; a text's does not."""

_STRING = re.compile(r"(?:w?string|str|stringa|char|testo|text|ascii(?: string| text| code)?)\s*[\[( ]?\s*(\d*)")

_TYPES: Mapping[str, str] = {
    **dict.fromkeys(
        ("bool", "boolean", "booleano", "bit", "digital", "digitale", "di", "do", "binario", "logico"), "bool"
    ),
    **dict.fromkeys(("int", "int16", "sint16", "short", "intero", "intero con segno", "signed", "s16", "i16"), "int16"),
    **dict.fromkeys(("integer", "short16", "signed int", "signed int 16", "int 16", "signed 16"), "int16"),
    **dict.fromkeys(("uint", "uint16", "word", "unsigned", "intero senza segno", "u16", "ushort", "uint 16"), "uint16"),
    **dict.fromkeys(("unsigned int", "ushort16", "unsigned 16", "unsigned int 16", "parola"), "uint16"),
    **dict.fromkeys(
        ("dint", "int32", "long", "intero lungo", "s32", "i32", "signed 32", "int 32", "doppio intero"), "int32"
    ),
    **dict.fromkeys(("udint", "uint32", "dword", "ulong", "u32", "unsigned 32", "uint 32", "doppia parola"), "uint32"),
    **dict.fromkeys(("lint", "int64", "s64", "i64", "int 64", "llong"), "int64"),
    **dict.fromkeys(("ulint", "uint64", "lword", "u64", "uint 64", "qword", "acc64", "bitfield64"), "uint64"),
    **dict.fromkeys(("acc32", "bitfield32", "enum32", "udword"), "uint32"),
    **dict.fromkeys(("acc16", "bitfield16", "enum16", "enum"), "uint16"),
    **dict.fromkeys(("sunssf", "int2", "s word"), "int16"),
    **{"u word": "uint16", "u dword": "uint32", "s dword": "int32", "u qword": "uint64", "s qword": "int64"},  # ESPHome
    "fp32": "float32",
    **dict.fromkeys(("int4",), "int32"),
    **dict.fromkeys(("float4",), "float32"),
    **dict.fromkeys(("float8",), "float64"),
    **dict.fromkeys(
        ("real", "float", "float32", "reale", "single", "floating point", "f32", "ieee754", "ieee 754"), "float32"
    ),
    **dict.fromkeys(("virgola mobile", "float 32", "real32", "real 32", "f"), "float32"),
    **dict.fromkeys(("lreal", "double", "float64", "f64", "doppia precisione", "float 64"), "float64"),
    **dict.fromkeys(("sint", "int8", "s8", "i8", "int 8"), "int8"),
    **dict.fromkeys(("usint", "uint8", "u8", "byte", "uint 8"), "uint8"),
    **dict.fromkeys(("bcd", "bcd16", "bcd 16"), "bcd16"),
    **dict.fromkeys(("bcd32", "dbcd", "lbcd", "bcd 32"), "bcd32"),
    **dict.fromkeys(("booleen", "logique", "binar", "digital ein", "logica"), "bool"),
    **dict.fromkeys(("ganzzahl", "entier", "entero"), "int16"),
    **dict.fromkeys(("wort", "mot", "palabra"), "uint16"),
    **dict.fromkeys(("doppelwort", "double mot", "doble palabra"), "uint32"),
    **dict.fromkeys(("doppelganzzahl", "double entier", "entier double", "doble entero", "entero doble"), "int32"),
    **dict.fromkeys(
        ("gleitkomma", "gleitkommazahl", "fliesskomma", "reel", "flottant", "virgule flottante", "coma flotante"),
        "float32",
    ),
}
KNOWN_TYPES = "BOOL, INT, UINT, WORD, DINT, UDINT, DWORD, LINT, ULINT, REAL, LREAL, BYTE, BCD, STRING[n]"

ORDERS: Mapping[str, str] = {
    **dict.fromkeys(
        ("abcd", "big endian", "big", "msb first", "high word first", "1234", "no", "none", "nessuno"), "ABCD"
    ),
    **dict.fromkeys(
        ("cdab", "word swap", "swap word", "low word first", "swapped", "3412", "si", "yes", "swap"), "CDAB"
    ),
    **dict.fromkeys(("big endian word swap", "big endian swapped", "mid little endian", "parola bassa prima"), "CDAB"),
    **dict.fromkeys(("badc", "byte swap", "swap byte", "2143", "mid big endian"), "BADC"),
    **dict.fromkeys(("dcba", "little endian", "little", "lsb first", "4321", "byte and word swap"), "DCBA"),
    **dict.fromkeys(("ab cd", "ab cd ef gh", "be", "msw first", "most significant word first", "high first"), "ABCD"),
    **dict.fromkeys(("high low", "hi lo", "big endian word order", "high word", "msw"), "ABCD"),
    **dict.fromkeys(("cd ab", "gh ef cd ab", "lsw first", "least significant word first", "low first"), "CDAB"),
    **dict.fromkeys(("low high", "lo hi", "word swapped", "words swapped", "swapped words", "swap words"), "CDAB"),
    **dict.fromkeys(("little endian byte swap", "little endian byte swapped", "low word", "lsw"), "CDAB"),
    **dict.fromkeys(("ba dc", "byte swapped", "bytes swapped", "big endian byte swap"), "BADC"),
    **dict.fromkeys(("big endian byte swapped", "little endian word swap", "little endian word swapped"), "BADC"),
    **dict.fromkeys(("dc ba", "le"), "DCBA"),
    **dict.fromkeys(("mid little endian",), "CDAB"),
}
_ORDER_NOT_IN_A_TYPE = frozenset(
    {"no", "none", "nessuno", "si", "yes", "1234", "3412", "2143", "4321", "big", "little"}
)
_PHRASES = sorted((set(ORDERS) - _ORDER_NOT_IN_A_TYPE), key=lambda phrase: -len(phrase.split()))

TABLES: Mapping[str, str] = {
    **dict.fromkeys(("holding", "holding register", "holding registers", "hr", "4x", "03", "fc3", "fc03"), "holding"),
    **dict.fromkeys(("holding reg", "registro holding", "mw", "registri di mantenimento", "fc 3", "fc 03"), "holding"),
    **dict.fromkeys(("input", "input register", "input registers", "ir", "3x", "04", "fc4", "fc04"), "input"),
    **dict.fromkeys(("registro input", "registro di ingresso", "input reg", "fc 4", "fc 04"), "input"),
    **{f"read {name}{s}": name.split()[0] for name in ("holding register", "input register") for s in ("", "s")},
    **dict.fromkeys(("read coil", "read coils", "read coil status"), "coil"),
    **dict.fromkeys(("read discrete input", "read discrete inputs", "read input status"), "discrete"),
    **dict.fromkeys(("coil", "coils", "0x", "01", "1", "fc1", "fc01", "fc 1", "fc 01", "bobina", "bobine"), "coil"),
    **dict.fromkeys(("discrete", "discrete input", "discrete inputs", "1x", "02", "2", "fc2", "fc02"), "discrete"),
    **dict.fromkeys(("ingresso digitale", "ingressi digitali", "fc 2", "fc 02"), "discrete"),
    **dict.fromkeys(
        ("halteregister", "registre de maintien", "registro de retencion", "registros de retencion"), "holding"
    ),
    **dict.fromkeys(("eingangsregister", "registre d entree", "registro de entrada", "registros de entrada"), "input"),
    **dict.fromkeys(("spule", "spulen", "bobines", "bobinas"), "coil"),
    **dict.fromkeys(
        ("digitaleingang", "digitaler eingang", "diskreter eingang", "entree discrete", "entree tor"), "discrete"
    ),
    **dict.fromkeys(("entrees discretes", "entrada discreta", "entradas discretas", "entrada digital"), "discrete"),
}
"""Register table, by its name, by the digit of references with an x, or by the function code that reads it."""
_TABLE_WORDS = frozenset(key for key in TABLES if len(key) > 2 and not key[0].isdecimal())
_PLAIN_ORDER = re.compile(
    r"endian|^[abcd]{4}$|^[a-h]{2}(?: [a-h]{2})+$|\bswap\w* (?:words?|bytes?)\b"
    r"|\b(?:words?|bytes?|parola|[ml]s[bw])\b.*\b(?:first|prima|swap\w*)"
)
_ORDER_WORDS = frozenset(key for key in ORDERS if _PLAIN_ORDER.search(key))
"""What is an order wherever it stands: `low high` may be alarms, `big` a bearing."""
_DIRECTIONS = frozenset({"direction", "dir", "direzione", "richtung", "sens", "direccion", "io", "i"})
_OF_SIGNALS = frozenset({"input", "discrete"})
TOLD_BY: Mapping[str, Callable[[str, frozenset[str]], bool]] = {
    # By itself "input" may be the direction of a signal, and "discrete" its kind.
    "table": lambda header, told: (
        told <= _TABLE_WORDS
        and not told <= _OF_SIGNALS
        and (told.isdisjoint(_OF_SIGNALS) or _DIRECTIONS.isdisjoint(header.split()))
    ),
    "order": lambda _, told: told <= _ORDER_WORDS,
    "dtype": lambda _, told: 2 * sum(map(_names_a_width, told)) > len(told),  # the others' rows are refused
}
"""Column -> whether it is told by its header and its cells, both as `cells.header_key` writes them."""
_READ_BY = {1: "coil", 2: "discrete", 3: "holding", 4: "input"}
_WRITTEN_BY = frozenset({5, 6, 10, 15, 16, 22, 23})
"""Functions that write; 10 is 16 in hexadecimal."""
_FUNCTION_WORDS = re.compile(
    r"\b(?:fc|fn|f|function|functions|funzione|code|read|write|r|w|and|e|or|holding|input|h"
    r"|funktion|eingang|eingange|ausgang|lesen|schreiben|und|fonction|lire|ecrire|entree|et|funcion|leer|escribir|entrada|y)\b"
)


def _names_a_width(key: str) -> bool:
    """Whether a cell is a type that says its width itself, as `s16` and `float32`: nothing else looks so."""
    return re.fullmatch(r"[a-z]+ ?(?:8|16|32|64)", key) is not None and parse_type(key) is not None


def parse_tables(key: str) -> tuple[str, ...] | None:
    """The tables that a cell of function codes reads (`03/06/16`); empty for writing alone, None for no codes."""
    plain = _FUNCTION_WORDS.sub(" ", re.sub(r"(?<=[a-z])(?=\d)|(?<=\d)(?=[a-z])", " ", key))
    parts = plain.split()
    if not parts or not all(part.isdecimal() for part in parts):
        return None
    numbers = {int(part) for part in parts}
    if not numbers <= set(_READ_BY) | _WRITTEN_BY:
        return None
    return tuple(_READ_BY[number] for number in sorted(numbers) if number in _READ_BY)


_FLAGS: Mapping[str, bool] = {
    **dict.fromkeys(("1", "true", "vero", "on", "acceso", "accesa", "si", "yes", "marcia", "attivo"), True),
    **dict.fromkeys(("attiva", "run", "running", "x"), True),
    **dict.fromkeys(("0", "false", "falso", "off", "spento", "spenta", "no", "arresto", "fermo"), False),
    **dict.fromkeys(("ferma", "inattivo", "inattiva", "stop", "stopped"), False),
    **dict.fromkeys(
        ("ein", "an", "ja", "wahr", "lauft", "marche", "oui", "vrai", "marcha", "encendido", "verdadero"), True
    ),
    **dict.fromkeys(("aus", "nein", "falsch", "steht", "arret", "non", "faux", "apagado", "parado"), False),
}


@dataclass(frozen=True, slots=True)
class TypeCell:
    """A type's cell: the type, a text's bytes, the order that it names, and whether it says how wide the number is.

    `unknown` is a word of it that is not understood; then the rest means nothing.
    """

    dtype: str = ""
    length: int = 0
    order: str = ""
    wide: bool = True
    unknown: str = ""


_FLOAT = frozenset({"float", "real", "reale", "floating", "point", "ieee", "754", "ieee754", "single", "precision"})
_BIT_FIELDS = frozenset({"flags", "bitfield", "bitmap", "bitmask"})
_PLAIN = frozenset({"uint", "word", "wort", "parola", "mot", "palabra"}) | _BIT_FIELDS
_SIGNED = frozenset({"int", "integer", "intero", "entero", "entier", "ganzzahl", "inteiro", "s"})
_UNSIGNED_PHRASE = re.compile(
    r"\b(?:unsigned|(?:senza|sin|sem|sans|non|no|ohne|without|not) (?:segno|signo|sinal|signe|signed|sign|vorzeichen)"
    r"|vorzeichenlos|nicht vorzeichenbehaftet)\b"
)
_SIGNED_PHRASE = re.compile(
    r"\b(?:signed|(?:con|com|avec|mit|with) (?:segno|signo|sinal|signe|sign|vorzeichen)|signe|vorzeichenbehaftet"
    r"|(?:two|twos|two s|2 s|2s) complement|complemento a (?:2|due|dos))\b"
)


def parse_sign(key: str) -> tuple[bool | None, str]:
    """(whether a text says that a number has a sign, None where it does not say; the rest of it)."""
    for pattern, signed in ((_UNSIGNED_PHRASE, False), (_SIGNED_PHRASE, True)):
        if pattern.search(key):
            return signed, " ".join(pattern.sub(" ", key).split())
    return None, key


_FILLERS = frozenset({"bit", "bits", "value", "number", "format", "register", "registers", "reg", "regs", "numero"})
_WIDTHLESS = _BIT_FIELDS | frozenset({"integer", "signed", "unsigned", "intero", "unsigned integer", "signed integer"})
_COUNTED = re.compile(r"(\d) (?:registers?|words?|regs?|registri)")
"""`2 registers` in a type's cell."""


_SUFFIXED = re.compile(r"(u?int(?:8|16|32|64)|float|double)(be|le|sw|sb)")
_SUFFIXES = {"be": "ABCD", "le": "DCBA", "sw": "CDAB", "sb": "BADC"}
"""`uint32sw` and its like in ioBroker's tables: big and little endian, swapped words, swapped bytes."""
_REVERSED = re.compile(r"([us] [dq]word|fp32) r")
"""`U_DWORD_R` of ESPHome: the words from the last one on."""


def type_cell(key: str) -> TypeCell:
    """A type's cell, as `cells.header_key` writes it."""
    if match := _REVERSED.fullmatch(key):
        return TypeCell(_TYPES[match[1]], order="CDAB")
    if match := _SUFFIXED.fullmatch(key):
        return TypeCell("float64" if match[1] == "double" else _TYPES[match[1]], order=_SUFFIXES[match[2]])
    for start in (key, key.replace("32bit", "32 bit").replace("16bit", "16 bit").replace("64bit", "64 bit")):
        if found := parse_type(start):
            return TypeCell(found[0], found[1], wide=start not in _WIDTHLESS)
    words, order = f" {key} ", ""
    # The longest phrase first: `little endian byte swap` is another order than `little endian`.
    for phrase in _PHRASES:
        if f" {phrase} " in words:
            words, order = words.replace(f" {phrase} ", "  ", 1), ORDERS[phrase]
            break
    rest = " ".join(words.split())
    count = _COUNTED.search(rest)
    rest = " ".join(_COUNTED.sub(" ", rest).split())
    found = parse_type(rest)
    signed: bool | None = None
    if found is None:
        signed, rest = parse_sign(rest)
        found = parse_type(rest)
        # `signed BCD` has its sign in a nibble, and `signed char` is no text.
        if found and signed is not None and not found[0].startswith(("int", "uint", "float")):
            return TypeCell(unknown=rest)
    wide = rest not in _WIDTHLESS
    if found and signed is not None and found[0].startswith(("int", "uint")):
        if signed and found[0].startswith("uint") and rest.startswith("u"):
            return TypeCell(unknown="signed")
        found = (("" if signed else "u") + found[0].removeprefix("u"), 0)
    if found is None:
        tokens = [token for token in re.sub(r"(\d)bit", r"\1 bit", rest).split() if token not in _FILLERS]
        widths = [token for token in tokens if token in ("8", "16", "32", "64")]
        kinds = [token for token in tokens if token not in widths]
        unknown = [token for token in kinds if token not in _FLOAT | _PLAIN | _SIGNED]
        if unknown or len(widths) > 1 or not (kinds or signed is not None):
            return TypeCell(unknown=(unknown or tokens or [key])[0])
        wide = bool(widths) or not set(kinds) <= _WIDTHLESS | _FLOAT
        unsigned = bool(set(kinds) & _PLAIN) if signed is None else not signed
        kind = "float" if set(kinds) & _FLOAT else "uint" if unsigned else "int"
        bits = widths[0] if widths else "32" if kind == "float" else "16"
        if kind == "float" and bits not in ("32", "64"):
            return TypeCell(unknown=bits)
        found = (f"{kind}{bits}", 0)
    dtype, length = found
    if count is not None:
        widened = widen_type(dtype, int(count[1]), wide=wide)
        if not widened:
            return TypeCell(unknown=count[0])
        dtype, wide = widened, True
    return TypeCell(dtype, length, order, wide)


def widen_type(dtype: str, registers: int, *, wide: bool) -> str:
    """The type of its kind that has so many registers; "" where it says another width itself."""
    own = WIDTHS.get(dtype, 0)
    if own in (0, registers):
        return dtype
    kind = dtype.rstrip("0123456789")
    widened = f"{kind}{16 * registers}"
    return widened if not wide and widened in WIDTHS else ""


WIDTHS: Mapping[str, int] = {
    **dict.fromkeys(("bool", "int8", "uint8", "int16", "uint16", "bcd16"), 1),
    **dict.fromkeys(("int32", "uint32", "float32", "bcd32"), 2),
    **dict.fromkeys(("int64", "uint64", "float64"), 4),
}
"""Registers of a type; a text has as many as it needs."""


def parse_type(key: str) -> tuple[str, int] | None:
    """(type, length in bytes) by a type's whole name without case and signs; None for one that is not known."""
    if match := _STRING.fullmatch(key):
        return "string", int(match[1] or 0)
    found = _TYPES.get(key) or _TYPES.get(key.replace(" ", ""))
    return (found, 0) if found else None


_MEASURED = re.compile(
    r"(\d+) ?(?:(bits?)|(bytes?|octets?|octeti?|chars?|characters?|zeichen|caratteri|caracteres)"
    r"|(words?|worte?|parole|mots?|palabras?|regs?|registers?|registri|registres?|registros?))"
)


def parse_size(key: str) -> int | None:
    """The bits of a size that says in what it counts (`2byte`, `4 registers`); None for any other."""
    match = _MEASURED.fullmatch(key)
    return int(match[1]) * (1 if match[2] else 8 if match[3] else 16) if match else None


def parse_flag(key: str) -> bool | None:
    """On or off, by what an HMI writes; None for a word that is neither."""
    return _FLAGS.get(key)
