"""What the words of the write-back block mean, for people: unit and meaning of each field, names of the alarm bits."""

from collections.abc import Mapping

from drivers.device_file import BlockField
from gateway.machine.writing import NO_NUMBER, NO_TEMPERATURE
from gateway.settings import WritebackLayout

MEANINGS: Mapping[str, tuple[str, str]] = {
    "layout_version": ("", "the layout of this block"),
    "sequence": ("", "counts blocks, 0 to 65535"),
    "heartbeat": ("", "changes with every block"),
    "validity": ("", "bit 0 all usable, 1 inputs good, 2 location known, 3 forecast fresh, 4 model loaded, 5 shadow"),
    "input_quality": ("", "0 good, 1 uncertain, 2 bad"),
    "age": ("s", "since the oldest input was read"),
    "location": ("", "index of the location in the model's list"),
    "temperature_now": ("degC", "predicted for this moment"),
    "band_low": ("degC", "lower end of its 90 % band"),
    "band_high": ("degC", "upper end of its 90 % band"),
    "horizon": ("s", "how far ahead the forecast looks"),
    "horizon_low": ("degC", "5 % quantile at the horizon"),
    "horizon_median": ("degC", "median at the horizon"),
    "horizon_high": ("degC", "95 % quantile at the horizon"),
    "p_limit": ("", "probability that the limit is reached within the horizon, 0 to 1"),
    "minutes_low": ("min", "to the limit, at the earliest"),
    "minutes_median": ("min", "to the limit, median"),
    "minutes_high": ("min", "to the limit, at the latest"),
    "zone": ("", "confidence in the model: 0 none, 1 green, 2 yellow, 3 red"),
    "alarms": ("", "alarm bits"),
    "anomaly": ("", "-log10 of the p-value of the newest prediction errors"),
    "model_hash": ("", "low word of the model's SHA-256"),
    "challenge": ("", "the PLC's Challenge, as the scan before the block read it"),
    "writer": ("", "the number of this start of the gateway, 1 to 65535"),
    "crc": ("", "CRC-16/IBM-3740 of the words before it, high byte first"),
    "sequence_copy": ("", "equals sequence in a block that was not torn"),
}
"""Unit and meaning by the field's name."""

FRAME = frozenset(
    {"layout_version", "sequence", "heartbeat", "validity", "challenge", "writer", "crc", "sequence_copy"}
)
"""The fields by which a block is checked."""

ALWAYS_KNOWN = FRAME | {"alarms", "model_hash"}
"""Fields without a word for "not known"."""

ALARM_BITS = (
    "OverLimit", "PredictedOverLimit", "AnomalyFound", "Drift", "InputsBad", "Review", "DeviceFault", "RecordsFault",
    "ClockFault",
)  # fmt: skip
"""The alarm word's bits from bit 0, by the names of the function block's outputs."""

ALARM_MEANINGS: Mapping[str, str] = {
    "OverLimit": "a measured temperature is over the limit",
    "PredictedOverLimit": "it is predicted to pass the limit",
    "AnomalyFound": "the readings do not fit the model",
    "Drift": "the model drifts, on several cycles running",
    "InputsBad": "what the model reads is stale or bad",
    "Review": "the readings lie outside 3 sigma too often",
    "DeviceFault": "the device itself, or its bus, reports a fault",
    "RecordsFault": "the gateway's records cannot be relied on",
    "ClockFault": "the gateway's clock has jumped",
}


def describe_field(name: str) -> str:
    """Meaning and unit of a field in one phrase."""
    unit, meaning = MEANINGS[name]
    return f"{meaning} ({unit})" if unit else meaning


def unknown_word(field: BlockField, layout: WritebackLayout) -> int:
    """The word by which a field says "not known", for one that can."""
    if field.name.startswith("minutes_"):
        return layout.unknown
    return NO_TEMPERATURE if field.signed else NO_NUMBER
