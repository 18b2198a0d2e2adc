"""How well a running gateway is: one table of checks over its status, and one word that a script can act on."""

from collections.abc import Callable
from dataclasses import dataclass

from gateway.outside.status.health_words import Health
from gateway.outside.status.picture import GatewayStatus, TagStatus, TemperatureStatus
from sim.phrase import Phrase
from sim.units import display_unit

UNFORESEEN = "no forecast"
"""The kind of the alarm that no usable forecast comes."""
MOST_NAMED = 3
"""How many tags, alarms or parts one sentence names; the rest is counted."""


@dataclass(frozen=True, slots=True)
class HealthFinding:
    """What a check found wrong, in a sentence."""

    check: str
    sentence: str


def list_names(names: list[str]) -> str:
    """The first names, and how many more there are."""
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def not_good(status: GatewayStatus) -> list[tuple[str, TagStatus]]:
    """The tags whose reading is not good, in the order of the device file."""
    return [(name, tag) for name, tag in status.values.items() if tag.quality != "GOOD"]


def readings_sentence(status: GatewayStatus) -> str:
    """Which readings are not good and why; "" if all are."""
    bad = not_good(status)
    if not bad:
        return ""
    tags = list_names([f"{name} {tag.quality}" for name, tag in bad])
    reason = f": {bad[0][1].reason}" if bad[0][1].reason else ""
    return f"{len(bad)} of {len(status.values)} readings are not good, {tags}{reason}"


def link_sentence(status: GatewayStatus) -> str:
    """Why no present reading is to be had; "" while there is one."""
    scan, link = status.scan, status.link
    if scan.age is None:
        return "the device has not been read yet"
    if scan.late:
        return f"the device has not been read for {scan.age / status.speed:.1f} s"
    if link.alive:
        return ""
    gone = None if link.last_good is None else (status.time - link.last_good) / status.speed
    since = "since the start" if gone is None else f"for {gone:.1f} s"
    return f"no good reading {since}: {link.reason}" if link.reason else f"no good reading {since}"


REFUSED = Phrase(
    "the promoted model is refused: {reason}",
    it="il modello promosso è rifiutato: {reason}",
    de="das beförderte Modell ist abgelehnt: {reason}",
)
UNFIT = Phrase(
    "the model is unfit: {reason}", it="il modello non è idoneo: {reason}", de="das Modell ist unbrauchbar: {reason}"
)
STATE_UNKNOWN = Phrase(
    "the state of the plant is not known, so that nothing is predicted",
    it="lo stato dell'impianto non è noto, quindi non si prevede nulla",
    de="der Zustand der Anlage ist nicht bekannt, daher wird nichts vorhergesagt",
)
DOES_NOT_FOLLOW = Phrase(
    "the confidence is {zone}: the readings do not follow the model (anomaly {anomaly}){alarm}",
    it="la fiducia è {zone}: le letture non seguono il modello (anomalia {anomaly}){alarm}",
    de="das Vertrauen ist {zone}: die Messwerte folgen dem Modell nicht (Anomalie {anomaly}){alarm}",
)
# What to believe and what to look at begin at different scores.
NO_ALARM = Phrase(
    "; do not rely on the forecast now, and look at the machine if the alarm comes",
    it="; non affidarsi ora alla previsione, e controllare la macchina se arriva l'allarme",
    de="; der Vorhersage jetzt nicht vertrauen, und nach der Maschine sehen, wenn der Alarm kommt",
)
ZONE_WORDS = {"yellow": Phrase("yellow", it="media", de="mäßig"), "red": Phrase("red", it="bassa", de="gering")}


def _models(status: GatewayStatus) -> str:
    followed: list[GatewayStatus | TemperatureStatus] = [status, *status.further]
    first, *others = [(one, model_sentence(status, one)) for one in followed]
    said = [first[1], *(f"{one.temperature}: {sentence}" for one, sentence in others if sentence)]
    return said[0] if len(said) == 1 else "; ".join(filter(None, said))


def model_sentence(status: GatewayStatus, one: GatewayStatus | TemperatureStatus) -> str:
    """Why the prediction of a temperature is not to be relied on; "" if it is, and without a model."""
    p, model = one.prediction, one.model
    if model is not None and model.refused:
        return REFUSED.fill(reason=model.refused)
    if model is not None and model.verdict == "unfit":
        return UNFIT.fill(reason=model.verdict_sentence.removeprefix("unfit: "))
    if link_sentence(status):
        return ""
    if p is not None and not p.known:
        return STATE_UNKNOWN
    if any(
        alarm.kind == UNFORESEEN and alarm.active and alarm.tag == one.temperature for alarm in status.alarm_summary
    ):
        return unforeseen_sentence(status, one)
    if p is None:
        return ""
    if strange := unfamiliar_sentence(one):
        return strange
    if p.zone in ("yellow", "red"):
        stands = any(a.kind == "anomaly" and a.active and a.tag == one.temperature for a in status.alarm_summary)
        alarm = "" if stands else NO_ALARM
        return DOES_NOT_FOLLOW.fill(zone=ZONE_WORDS[p.zone], anomaly=f"{p.anomaly or 0.0:.1f}", alarm=alarm)
    return ""


UNFORESEEN_FOR = Phrase(
    "nothing is foreseen: {reason}", it="nessuna previsione: {reason}", de="es gibt keine Vorhersage: {reason}"
)
NONE_FINISHED = Phrase(
    "no forecast has been finished yet",
    it="nessuna previsione è stata ancora completata",
    de="noch keine Vorhersage ist fertig geworden",
)
TOO_LATE = Phrase(
    "the newest forecast is {seconds} s old, and newer ones do not come in time",
    it="l'ultima previsione ha {seconds} s e le successive non arrivano in tempo",
    de="die neueste Vorhersage ist {seconds} s alt, und neuere kommen nicht rechtzeitig",
)


def unforeseen_sentence(status: GatewayStatus, one: GatewayStatus | TemperatureStatus) -> str:
    """Why there has been no usable forecast for longer than is usual."""
    failures = [part["failure"] for name, part in status.parts.items() if "forecast" in name and part["failure"]]
    if failures:
        return UNFORESEEN_FOR.fill(reason=failures[0])
    if one.forecast is None:
        return UNFORESEEN_FOR.fill(reason=NONE_FINISHED)
    return UNFORESEEN_FOR.fill(reason=TOO_LATE.fill(seconds=f"{one.forecast.age / status.speed:.0f}"))


def unfamiliar_sentence(one: GatewayStatus | TemperatureStatus) -> str:
    """Why the confidence is lowered where it is the present cycle that the training never had; "" elsewhere."""
    p = one.prediction
    f = None if p is None else p.familiarity
    # Readings that do not follow the model are the worse news.
    if p is None or f is None or not f.outside or p.zone != f.zone:
        return ""
    return f"the confidence is {p.zone}: the present cycle is unlike the training: {f.sentence}"


NOT_BY_MODEL = Phrase(
    "{tag}: sensor bad for {lasting} ({reason}); not known by the model either: {stopped}",
    it="{tag}: sensore guasto da {lasting} ({reason}); non noto nemmeno dal modello: {stopped}",
    de="{tag}: Sensor seit {lasting} gestört ({reason}); auch nach dem Modell nicht bekannt: {stopped}",
)
BY_MODEL = Phrase(
    "{tag}: sensor bad ({reason}); by {whom} {said}, for {lasting}",
    it="{tag}: sensore guasto ({reason}); secondo {whom} {said}, da {lasting}",
    de="{tag}: Sensor gestört ({reason}); nach {whom} {said}, seit {lasting}",
)
THE_MODEL = Phrase("the model", it="il modello", de="dem Modell")
THE_MODEL_AND = Phrase("the model and {twin}", it="il modello e {twin}", de="dem Modell und {twin}")


def virtual_sentence(status: GatewayStatus, one: GatewayStatus | TemperatureStatus) -> str:
    """What the model says of a temperature in place of its bad sensor, or why it does not; "" while that is good."""
    v = None if one.prediction is None else one.prediction.virtual
    if v is None or link_sentence(status):
        return ""
    gone = (status.time - v.since) / status.speed
    lasting = f"{gone:.0f} s" if gone < 120.0 else f"{gone / 60.0:.0f} min"
    if v.mean is None or v.low is None or v.high is None:
        return NOT_BY_MODEL.fill(tag=one.temperature, lasting=lasting, reason=v.reason, stopped=v.stopped)
    said = f"{v.mean:.1f} {display_unit(one.unit)} ({v.low:.1f} to {v.high:.1f})"
    whom = THE_MODEL_AND.fill(twin=v.twin) if v.twin else THE_MODEL
    return BY_MODEL.fill(tag=one.temperature, reason=v.reason, whom=whom, said=said, lasting=lasting)


def _virtual(status: GatewayStatus) -> str:
    all_of_them: list[GatewayStatus | TemperatureStatus] = [status, *status.further]
    said = [sentence for one in all_of_them if (sentence := virtual_sentence(status, one))]
    return said[0] if len(said) == 1 else "; ".join(said)


def records_sentence(status: GatewayStatus) -> str:
    """Why the records cannot be relied on; "" if they can."""
    audit: str = (status.writeback.get("audit") or {}).get("complaint") or ""
    return status.historian.failure or status.historian.complaint or audit


def _alarms(status: GatewayStatus) -> str:
    # The plant's are found at the machine that looks after them.
    standing = [alarm for alarm in status.alarm_summary if alarm.active]
    return list_names([f"{'plant: ' if alarm.of_plant else ''}{alarm.name} ({alarm.state})" for alarm in standing])


NO_REASON = Phrase("no reason", it="nessun motivo", de="kein Grund")
NOT_WRITTEN = Phrase(
    "armed, and the newest block was not written ({verdict}): {reason}",
    it="armato, e l'ultimo blocco non è stato scritto ({verdict}): {reason}",
    de="scharf, und der neueste Block wurde nicht geschrieben ({verdict}): {reason}",
)


def _writeback(status: GatewayStatus) -> str:
    w = status.writeback
    if w.get("mode") != "armed" or w.get("last_verdict") in (None, "written"):
        return ""
    return NOT_WRITTEN.fill(verdict=w["last_verdict"], reason=w.get("last_reason") or NO_REASON)


def _parts(status: GatewayStatus) -> str:
    stopped = [
        (name, part["failure"]) for name, part in status.parts.items() if part["failure"] and not part["running"]
    ]
    return list_names([f"{name}: {failure}" for name, failure in stopped])


CHECKS: dict[str, Callable[[GatewayStatus], str]] = {
    "link": link_sentence,
    "readings": readings_sentence,
    "alarms": _alarms,
    "model": _models,
    "sensors": _virtual,
    "write-back": _writeback,
    "records": records_sentence,
    "parts": _parts,
    "clock": lambda status: str(status.clock.get("complaint") or ""),
    "device": lambda status: list_names(list(status.complaints)),
}
"""All that is looked at, in the order in which it is said; "" is well."""


def findings(status: GatewayStatus) -> tuple[HealthFinding, ...]:
    """All that is wrong with a gateway that answers; none if it is well."""
    found = {name: check(status) for name, check in CHECKS.items()}
    # Without a link nothing is good: that the readings are not says nothing more.
    if found["link"]:
        found["readings"] = ""
    return tuple(HealthFinding(name, sentence) for name, sentence in found.items() if sentence)


def judge_health(status: GatewayStatus) -> Health:
    """The word for a gateway that answers."""
    found = findings(status)
    if any(finding.check == "link" for finding in found):
        return Health.NO_READINGS
    return Health.ATTENTION if found else Health.WELL
