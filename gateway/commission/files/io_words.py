"""The words of I/O lists: how columns, types, orders and tables are called in Italian and English ones."""

import re
from collections.abc import Mapping

COLUMNS: Mapping[str, tuple[str, ...]] = {
    "name": (
        *("tag", "tag name", "tagname", "nome tag", "nome", "name", "sigla", "variabile", "variable", "segnale"),
        *("signal", "simbolo", "symbol", "nome variabile", "nome segnale", "etichetta", "item", "punto", "point"),
    ),
    "address": (
        *("indirizzo", "address", "indirizzo modbus", "modbus address", "registro", "register", "addr", "ind"),
        *("indirizzo plc", "plc address", "modbus register", "registro modbus", "offset modbus", "nodeid", "object"),
        *("oggetto", "index", "indice"),
    ),
    "table": (
        *("area", "tabella", "table", "tipo registro", "register type", "tipo di registro", "memory area"),
        *("area di memoria", "funzione", "function", "function code", "codice funzione", "object type"),
    ),
    "dtype": (
        *("tipo dato", "tipo di dato", "data type", "datatype", "tipo", "type", "formato", "format", "dtype"),
        *("tipo variabile", "variable type"),
    ),
    "order": (
        *("ordine", "order", "byte order", "word order", "ordine word", "ordine parole", "ordine byte", "endianness"),
        *("swap", "byte word order"),
    ),
    "bit": ("bit", "n bit", "numero bit", "bit number", "posizione bit"),
    "length": ("lunghezza", "length", "len", "byte", "bytes", "caratteri"),
    "scale": (
        *("scala", "scale", "fattore", "factor", "fattore di scala", "scale factor", "scaling", "moltiplicatore"),
        *("multiplier", "gain", "guadagno", "risoluzione", "resolution", "k", "coefficiente"),
    ),
    "offset": ("offset", "scostamento", "zero"),
    "unit": (
        *("unita", "unita di misura", "unita misura", "um", "u m", "unit", "units", "ing unit", "eng unit"),
        *("engineering unit", "engineering units", "eu", "udm", "u d m", "misura"),
    ),
    "raw_low": ("raw min", "min raw", "grezzo min", "min grezzo", "raw low", "inizio scala raw", "count min"),
    "raw_high": ("raw max", "max raw", "grezzo max", "max grezzo", "raw high", "fondo scala raw", "count max"),
    "low": (
        *("min", "minimo", "minimum", "low", "eng min", "min eng", "min ing", "ing min", "inizio scala"),
        *("range min", "limite inferiore", "eu min", "lo"),
    ),
    "high": (
        *("max", "massimo", "maximum", "high", "eng max", "max eng", "max ing", "ing max", "fondo scala"),
        *("range max", "limite superiore", "eu max", "hi"),
    ),
    "sentinel": ("sentinella", "sentinel", "non disponibile", "not available", "valore guasto", "fault value", "na"),
    "access": ("accesso", "access", "r w", "rw", "lettura scrittura", "read write", "permessi", "direzione"),
}
"""Column -> the headers by which it is recognised, as `cells.key_of` writes them; the first that fits wins."""

_BITS = re.compile(r"(\d+)\s*bit")
_STRING = re.compile(r"(?:w?string|stringa|char|testo|text)\s*[\[( ]?\s*(\d*)")

_TYPES: Mapping[str, str] = {
    **dict.fromkeys(
        ("bool", "boolean", "booleano", "bit", "digital", "digitale", "di", "do", "binario", "logico"), "bool"
    ),
    **dict.fromkeys(("int", "int16", "sint16", "short", "intero", "intero con segno", "signed", "s16", "i16"), "int16"),
    **dict.fromkeys(("integer", "signed int", "signed int 16", "int 16", "signed 16"), "int16"),
    **dict.fromkeys(("uint", "uint16", "word", "unsigned", "intero senza segno", "u16", "ushort", "uint 16"), "uint16"),
    **dict.fromkeys(("unsigned int", "unsigned 16", "unsigned int 16", "parola"), "uint16"),
    **dict.fromkeys(
        ("dint", "int32", "long", "intero lungo", "s32", "i32", "signed 32", "int 32", "doppio intero"), "int32"
    ),
    **dict.fromkeys(("udint", "uint32", "dword", "ulong", "u32", "unsigned 32", "uint 32", "doppia parola"), "uint32"),
    **dict.fromkeys(("lint", "int64", "s64", "i64", "int 64"), "int64"),
    **dict.fromkeys(("ulint", "uint64", "lword", "u64", "uint 64", "qword"), "uint64"),
    **dict.fromkeys(
        ("real", "float", "float32", "reale", "single", "floating point", "f32", "ieee754", "ieee 754"), "float32"
    ),
    **dict.fromkeys(("virgola mobile", "float 32", "real32", "real 32", "f"), "float32"),
    **dict.fromkeys(("lreal", "double", "float64", "f64", "doppia precisione", "float 64"), "float64"),
    **dict.fromkeys(("sint", "int8", "s8", "i8", "int 8"), "int8"),
    **dict.fromkeys(("usint", "uint8", "u8", "byte", "uint 8"), "uint8"),
    **dict.fromkeys(("bcd", "bcd16", "bcd 16"), "bcd16"),
    **dict.fromkeys(("bcd32", "dbcd", "bcd 32"), "bcd32"),
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
}

TABLES: Mapping[str, str] = {
    **dict.fromkeys(("holding", "holding register", "holding registers", "hr", "4x", "03", "fc3", "fc03"), "holding"),
    **dict.fromkeys(("holding reg", "registro holding", "mw", "registri di mantenimento", "fc 3", "fc 03"), "holding"),
    **dict.fromkeys(("input", "input register", "input registers", "ir", "3x", "04", "fc4", "fc04"), "input"),
    **dict.fromkeys(("registro input", "registro di ingresso", "input reg", "fc 4", "fc 04"), "input"),
    **dict.fromkeys(("coil", "coils", "0x", "01", "1", "fc1", "fc01", "fc 1", "fc 01", "bobina", "bobine"), "coil"),
    **dict.fromkeys(("discrete", "discrete input", "discrete inputs", "1x", "02", "2", "fc2", "fc02"), "discrete"),
    **dict.fromkeys(("ingresso digitale", "ingressi digitali", "fc 2", "fc 02"), "discrete"),
}
"""Register table, by its name, by the digit of references with an x, or by the function code that reads it."""
FUNCTIONS: Mapping[str, str] = {"3": "holding", "4": "input"}
"""Bare digits, where the column is one of function codes; elsewhere 4 may also mean the references from 40001 on."""

_FLAGS: Mapping[str, bool] = {
    **dict.fromkeys(("1", "true", "vero", "on", "acceso", "accesa", "si", "yes", "marcia", "attivo"), True),
    **dict.fromkeys(("attiva", "run", "running", "x"), True),
    **dict.fromkeys(("0", "false", "falso", "off", "spento", "spenta", "no", "arresto", "fermo"), False),
    **dict.fromkeys(("ferma", "inattivo", "inattiva", "stop", "stopped"), False),
}


def type_of(key: str) -> tuple[str, int] | None:
    """(type, length in bytes) by a type's name without case and signs; None for one that is not known."""
    if match := _STRING.fullmatch(key):
        return "string", int(match[1] or 0)
    if key in _TYPES:
        return _TYPES[key], 0
    compact = key.replace(" ", "")
    if compact in _TYPES:
        return _TYPES[compact], 0
    # `32 bit float`, `16-bit unsigned integer` and the like: the kind by its words, the width by its number. Unsigned
    # comes before signed, because both have the word integer.
    match = _BITS.search(key)
    if match is None:
        return None
    bits, words = match[1], set(key.split())
    widths: tuple[str, ...] = ("8", "16", "32", "64")
    if words & {"float", "real", "reale", "floating", "ieee"}:
        kind, widths = "float", ("32", "64")
    elif words & {"unsigned", "uint", "word"} or "senza segno" in key:
        kind = "uint"
    elif words & {"signed", "int", "integer", "intero"}:
        kind = "int"
    else:
        return None
    return (f"{kind}{bits}", 0) if bits in widths else None


def flag_of(key: str) -> bool | None:
    """On or off, by what an HMI writes; None for a word that is neither."""
    return _FLAGS.get(key)
