"""The kinds of alarms a machine may have, in one table, and what a plant file may say of each."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from math import isinf
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, field_validator

from drivers.errors import did_you_mean
from drivers.settings import Line, Section
from sim.anomaly import DEADBAND_SHARE
from sim.phrase import Phrase

if TYPE_CHECKING:
    from gateway.settings.config import Config

ANOMALY_FLOOR = 10.0
"""The anomaly score that is worth an alarm where neither the plant file nor the model's own record says another."""
MOST_URGENT, LEAST_URGENT = 1, 4
"""The priorities: 1 is the most urgent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MachineSigns:
    """What a machine and its plant show their alarms at a scan, beside what sensors and models find.

    `good` gives the scan's reading of a tag, None for a bad one; `worst_inputs` how the worst input of each prediction
    is: 0 good, 1 uncertain, 2 bad. Texts are "" where nothing is wrong, numbers None where they are not known; `rival`
    is None where nothing is written. `clock_speed` is in plant seconds a real one, `clock_error` in s, `free_mb` in MB.
    """

    config: "Config"
    good: Callable[[str], float | None]
    worst_inputs: tuple[float, ...]
    link_alive: bool
    records_complaint: str
    failed_parts: str
    missing_parts: Mapping[str, str]
    clock_complaint: str
    clock_speed: float
    clock_error: float | None
    free_mb: float | None
    certificate_days: float | None
    undelivered: str
    unreached: str
    complaints: tuple[str, ...]
    rival: str | None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmPlace:
    """Of what an alarm would be: a machine, or its temperature `tag`, whose model and limit `config` has then.

    `inputs` are the tags that its models read, or that are watched; `complains`: its driver hears what is wrong with
    the device. `stale_after`: for how long (s) a reading may be held. `anomaly_level` is the score that the model's own
    record says is passed once a week at most; None without such a record.
    """

    config: "Config"
    tag: str = ""
    inputs: tuple[str, ...] = ()
    complains: bool = False
    stale_after: float = 0.0
    anomaly_level: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmKind:
    """One kind, from which all that speaks of alarms is made. Raises ValueError where its parts do not fit.

    `subject` is what there is one of for each: the plant, a machine, a watched temperature of it, a predicted one.
    `applies` says whether there is such an alarm somewhere, `limit` what its number must not exceed there, `more` what
    else of its condition is not as usual. `finding` gives that number by what a machine shows at a scan, None where it
    is not known; of temperatures the stages of a scan find it (`SensorWatch`, `ModelUnit`) under the kind's name.

    `title`, `response` and `consequence` are said in the reader's language while it is so, `past` where it was; in the
    first two `{tag}`, `{twin}`, `{limit}` and `{unit}` stand for the alarm's. Of one `cause` ("": none) are the kinds
    that tell of the same thing.
    `bit` is that in the block's alarm word (None: none); it, `priority` and the delay (plant s) are defaults, which a
    plant file may change. `namur` is the category of NAMUR NE 107 for what is wrong with a sensor: failure, out of
    specification or maintenance required.
    """

    subject: Literal["plant", "machine", "watched", "predicted"]
    title: Phrase
    past: Phrase
    watches: str
    response: Phrase
    consequence: Phrase
    applies: Callable[[AlarmPlace], bool]
    limit: Callable[[AlarmPlace], float]
    finding: Callable[[MachineSigns], float | None] | None = None
    more: Callable[[AlarmPlace], Mapping[str, Any]] = lambda _: {}
    bit: int | None = None
    priority: int = 2
    on_delay: float = 0.0
    namur: str = ""
    cause: str = ""

    def __post_init__(self) -> None:
        texts = (self.title, self.past, self.response, self.consequence)
        if not (all(text.whole for text in texts) and self.watches):
            raise ValueError(f"the kind of alarm {self.title!r} lacks a text, or a text in one of the languages")
        if (self.finding is None) != (self.subject in ("watched", "predicted")):
            raise ValueError(
                f"the kind of alarm {self.title!r} needs a finding where it is of a machine or the plant, and no other"
            )


HEAT = "heat"
"""The cause of all that tells that one bearing gets hot."""
FAULT_THRESHOLD = 0.5
"""What is found of a sensor beyond this is a fault; what is only yes or no is 1 or 0."""
DRIFT_SINCE = "14d"
"""The span of the historian that a diagnosis is offered for: ten cycles or more of a plant that runs every day."""


def always(_: AlarmPlace) -> bool:
    """There is such an alarm everywhere."""
    return True


def yes_or_no(_: AlarmPlace) -> float:
    """The limit of what is found as 1 or 0."""
    return FAULT_THRESHOLD


def flag_value(wrong: object) -> float:
    """1 for what is wrong, 0 where nothing is."""
    return float(bool(wrong))


def _anomaly_limit(at: AlarmPlace) -> float:
    """What the plant file says, else what the model's record says."""
    stated = at.config.alarms.anomaly
    return max(ANOMALY_FLOOR, at.anomaly_level or 0.0) if stated is None else stated


def _has_model(at: AlarmPlace) -> bool:
    return at.config.model.path is not None


def _has_sensor(at: AlarmPlace) -> bool:
    return at.config.alarms.sensors


def _threshold_settings(at: AlarmPlace) -> Mapping[str, Any]:
    predicted = [row.tag for row in at.config.temperatures]
    whose = at.tag if len(predicted) > 1 and at.tag in predicted else ""
    a = at.config.alarms
    return {"deadband": a.deadband, "on_delay": a.on_delay, "temperature": whose}


UNFORESEEN_PERIODS, UNFORESEEN_S = 6.0, 60.0
"""For so many periods of the forecast (of scans, where these are rarer), and so long (plant s), none may be usable."""


def _unforeseen_delays(at: AlarmPlace) -> Mapping[str, Any]:
    period = max(at.config.forecast.period, at.config.scan.period)
    return {"on_delay": max(UNFORESEEN_PERIODS * period, UNFORESEEN_S), "off_delay": 0.0}


def _drift(at: AlarmPlace) -> Mapping[str, Any]:
    """When the model drifts the operator gets the command that diagnoses the historian's recent cycles."""
    config = at.config
    command = ["decanter", "diagnose", "--model", str(config.model.path), "--historian", str(config.historian.path)]
    command += ["--machine", config.machine] if config.several else []
    command += ["--since", DRIFT_SINCE, "--out", str(config.historian.path.parent / "diagnosis")]
    drifts = f"the model's free run is beyond its limit on {config.alarms.drift_cycles} cycles running"
    return {"off_delay": 0.0, "response": f"{drifts}; find out what has changed with: {join(command)}"}


def _steering_sign(signs: MachineSigns) -> float | None:
    # A replay's clock is nobody's to steer.
    error = signs.clock_error if signs.clock_speed == 1.0 else None
    return None if error is None else flag_value(isinf(error))


def _lacking_mb(signs: MachineSigns) -> float | None:
    return None if signs.free_mb is None else signs.config.alarms.disk_mb - signs.free_mb


def _inputs(at: AlarmPlace) -> Mapping[str, Any]:
    # One reading that came late is no alarm: inputs have to be bad for as long as a value may be held.
    return {"tag": ", ".join(at.inputs) or at.config.machine, "on_delay": at.stale_after, "off_delay": 0.0}


def _worst_input(signs: MachineSigns) -> float:
    if not signs.worst_inputs:
        return flag_value(any(signs.good(name) is None for name in signs.config.watched_temperatures))
    return max(signs.worst_inputs)


_LOOK_AT_SENSOR = Phrase(
    "compare {tag} with a hand-held thermometer, then look at the sensor, its cable and its input",
    it="confrontare {tag} con un termometro portatile, poi controllare sensore, cavo e ingresso",
    de="{tag} mit einem Handthermometer vergleichen, dann Sensor, Kabel und Eingang prüfen",
)

ALARM_KINDS: Mapping[str, AlarmKind] = {
    "over limit": AlarmKind(
        subject="watched", bit=0, priority=1,
        title=Phrase("over its limit", it="oltre il limite", de="über der Grenze"),
        past=Phrase("was over its limit", it="era oltre il limite", de="war über der Grenze"),
        cause=HEAT,
        applies=always,
        limit=lambda at: at.config.find_limit(at.tag),
        more=_threshold_settings,
        watches="the measured temperature, against `alarms.limit`; it needs no model",
        response=Phrase(
            "{tag} is above {limit} {unit}: reduce the load and check the lubrication",
            it="{tag} supera {limit} {unit}: ridurre il carico e controllare la lubrificazione",
            de="{tag} liegt über {limit} {unit}: Last verringern und Schmierung prüfen",
        ),
        consequence=Phrase(
            "the bearing is damaged within minutes to hours",
            it="il cuscinetto si danneggia in minuti o ore",
            de="das Lager nimmt binnen Minuten bis Stunden Schaden",
        ),
    ),
    "predicted over limit": AlarmKind(
        subject="predicted", bit=1,
        title=Phrase("will pass its limit", it="supererà il limite", de="wird die Grenze überschreiten"),
        past=Phrase(
            "was predicted to pass its limit",
            it="era previsto il superamento del limite",
            de="Überschreiten der Grenze war vorhergesagt",
        ),
        cause=HEAT,
        applies=_has_model,
        limit=lambda at: at.config.alarms.p_limit,
        more=lambda at: {"deadband": at.config.alarms.p_limit / 2},
        watches="the chance that the limit is passed within the block's horizon, against `alarms.p_limit`",
        response=Phrase(
            "{tag} will pass its limit: look at load and lubrication while there is time",
            it="{tag} supererà il suo limite: controllare carico e lubrificazione finché c'è tempo",
            de="{tag} wird seine Grenze überschreiten: Last und Schmierung prüfen, solange Zeit ist",
        ),
        consequence=Phrase(
            "the limit is reached, and the load has to be thrown off",
            it="si raggiunge il limite e bisogna togliere il carico",
            de="die Grenze wird erreicht, und die Last muss abgeworfen werden",
        ),
    ),
    "anomaly": AlarmKind(
        subject="predicted", bit=2, priority=3,
        title=Phrase("does not fit the model", it="non segue il modello", de="passt nicht zum Modell"),
        past=Phrase("did not fit the model", it="non seguiva il modello", de="passte nicht zum Modell"),
        cause=HEAT,
        applies=_has_model,
        limit=_anomaly_limit,
        more=lambda at: {"deadband": _anomaly_limit(at) * DEADBAND_SHARE},
        watches="how unlikely the newest readings are by the model (out of distribution), against `alarms.anomaly`, or "
        "the level that the model's own record says is passed once a week at most",
        response=Phrase(
            "the readings of {tag} do not fit the model: look at the machine and at its sensors",
            it="le letture di {tag} non seguono il modello: controllare la macchina e i suoi sensori",
            de="die Messwerte von {tag} passen nicht zum Modell: Maschine und Sensoren prüfen",
        ),
        consequence=Phrase(
            "what is predicted is not to be relied on, and what the machine does is not what it used to do",
            it="la previsione non è affidabile, e la macchina non si comporta più come prima",
            de="auf die Vorhersage ist kein Verlass, und die Maschine verhält sich nicht wie bisher",
        ),
    ),
    "unfamiliar": AlarmKind(
        subject="predicted", bit=2, priority=3,
        title=Phrase("unlike the training", it="diverso dall'addestramento", de="anders als im Training"),
        past=Phrase("was unlike the training", it="era diverso dall'addestramento", de="war anders als im Training"),
        applies=_has_model,
        limit=lambda at: at.config.alarms.unfamiliar,
        more=lambda at: {"deadband": at.config.alarms.unfamiliar / 10},
        watches="how strange the present cycle is to the model's training, against `alarms.unfamiliar`; only with a "
        "model that knows its training",
        response=Phrase(
            "the present cycle of {tag} is unlike the model's training: see familiarity in the status for what is "
            "strange, and do not rely on the forecast alone",
            it="il ciclo attuale di {tag} è diverso dall'addestramento del modello: vedere la familiarità per sapere "
            "che cosa è insolito, e non affidarsi alla sola previsione",
            de="der gegenwärtige Zyklus von {tag} ist anders als im Training des Modells: siehe Vertrautheit, was "
            "daran fremd ist, und sich nicht auf die Vorhersage allein verlassen",
        ),
        consequence=Phrase(
            "the forecast is made for what nobody has seen, and its band may be too narrow",
            it="la previsione riguarda ciò che nessuno ha mai visto, e la sua banda può essere troppo stretta",
            de="die Vorhersage gilt für etwas, das noch niemand gesehen hat, und ihr Band kann zu schmal sein",
        ),
    ),
    "review": AlarmKind(
        subject="predicted", bit=5, priority=3,
        title=Phrase("model needs a review", it="modello da rivedere", de="Modell zu prüfen"),
        past=Phrase("the model needed a review", it="il modello era da rivedere", de="das Modell war zu prüfen"),
        applies=_has_model,
        limit=yes_or_no,
        watches="how often readings lie outside 3 sigma of the model, and whether it is unfit by its verdict",
        response=Phrase(
            "the model is unfit, or the readings lie beyond 3 sigma of it too often: look at its verdict and at the "
            "sensor, then learn or correct the model",
            it="il modello non è idoneo, o le letture ne escono troppo spesso da 3 sigma: guardare il suo verdetto e "
            "il sensore, poi riapprendere o correggere il modello",
            de="das Modell ist unbrauchbar, oder die Messwerte liegen zu oft außerhalb seiner 3 Sigma: sein Urteil und "
            "den Sensor prüfen, dann das Modell neu lernen oder korrigieren",
        ),
        consequence=Phrase(
            "the bands of the forecast are too narrow",
            it="le bande della previsione sono troppo strette",
            de="die Bänder der Vorhersage sind zu schmal",
        ),
    ),
    "drift": AlarmKind(
        subject="predicted", bit=3, priority=3,
        title=Phrase("model drifts", it="il modello deriva", de="Modell driftet"),
        past=Phrase("the model drifted", it="il modello derivava", de="das Modell driftete"),
        applies=_has_model,
        limit=lambda at: at.config.alarms.drift_cycles - 0.5,
        more=_drift,
        watches="the error of the model's free run, cycle by cycle (`alarms.drift`, `alarms.drift_cycles`)",
        response=Phrase(
            "the model's free run is beyond its limit on several cycles running; find out what has changed",
            it="la corsa libera del modello è oltre il limite da più cicli di fila: scoprire che cosa è cambiato",
            de="der freie Lauf des Modells liegt mehrere Zyklen in Folge über seiner Grenze: herausfinden, was sich "
            "geändert hat",
        ),
        consequence=Phrase(
            "the forecast is wrong by more than it says, in one direction",
            it="la previsione sbaglia più di quanto dice, in una direzione",
            de="die Vorhersage irrt in eine Richtung um mehr, als sie sagt",
        ),
    ),
    "no forecast": AlarmKind(
        subject="predicted",
        title=Phrase("nothing is foreseen", it="nessuna previsione", de="keine Vorhersage"),
        past=Phrase("nothing was foreseen", it="non c'era previsione", de="es gab keine Vorhersage"),
        applies=_has_model,
        limit=yes_or_no,
        more=_unforeseen_delays,
        watches="whether there is a usable forecast while all that the model reads is good, for six of its periods and "
        "a minute at least",
        response=Phrase(
            "no usable forecast of {tag} comes although the readings are good: see model and parts in the status for "
            "the cause, and watch {tag} itself meanwhile",
            it="non arriva una previsione valida di {tag} anche se le letture sono buone: vedere modello e parti nello "
            "stato per la causa, e intanto sorvegliare {tag}",
            de="es kommt keine brauchbare Vorhersage von {tag}, obwohl die Messwerte gut sind: siehe Modell und Teile "
            "im Status, und solange {tag} selbst beobachten",
        ),
        consequence=Phrase(
            "the limit comes without a warning; only the alarm at the limit is left",
            it="il limite arriva senza avviso; resta solo l'allarme al limite",
            de="die Grenze kommt ohne Warnung; es bleibt nur der Alarm an der Grenze",
        ),
    ),
    "rising": AlarmKind(
        subject="watched",
        title=Phrase("rises towards its limit", it="sale verso il limite", de="steigt zur Grenze hin"),
        past=Phrase("rose towards its limit", it="saliva verso il limite", de="stieg zur Grenze hin"),
        cause=HEAT,
        applies=lambda at: at.config.alarms.trend is not None,
        limit=lambda at: at.config.find_limit(at.tag),
        more=lambda at: {"deadband": at.config.alarms.deadband},
        watches="where a straight line through the last minutes reaches `alarms.trend` s ahead, against the limit; it "
        "needs no model",
        response=Phrase(
            "{tag} rises towards {limit} {unit}: look at load and lubrication while there is time",
            it="{tag} sale verso {limit} {unit}: controllare carico e lubrificazione finché c'è tempo",
            de="{tag} steigt auf {limit} {unit} zu: Last und Schmierung prüfen, solange Zeit ist",
        ),
        consequence=Phrase(
            "the limit is reached, and the load has to be thrown off",
            it="si raggiunge il limite e bisogna togliere il carico",
            de="die Grenze wird erreicht, und die Last muss abgeworfen werden",
        ),
    ),
    "sensor out of range": AlarmKind(
        subject="watched", on_delay=5.0, namur="failure",
        title=Phrase("sensor out of range", it="sensore fuori campo", de="Sensor außerhalb des Bereichs"),
        past=Phrase(
            "the sensor was out of range",
            it="il sensore era fuori campo",
            de="der Sensor war außerhalb des Bereichs",
        ),
        applies=_has_sensor,
        limit=yes_or_no,
        watches="readings beyond the tag's `low` and `high`, or that the device calls a failed sensor",
        response=_LOOK_AT_SENSOR,
        consequence=Phrase(
            "the temperature is not known, and neither is whether it is over its limit",
            it="non si conosce la temperatura, né se ha superato il limite",
            de="die Temperatur ist nicht bekannt, und auch nicht, ob sie über der Grenze liegt",
        ),
    ),
    "sensor frozen": AlarmKind(
        subject="watched", namur="failure",
        title=Phrase("sensor frozen", it="sensore bloccato", de="Sensor eingefroren"),
        past=Phrase("the sensor was frozen", it="il sensore era bloccato", de="der Sensor war eingefroren"),
        applies=_has_sensor,
        limit=yes_or_no,
        watches="a reading that does not move a bit while its twin, or the machine, does",
        response=_LOOK_AT_SENSOR,
        consequence=Phrase(
            "a bearing that heats is not seen",
            it="un cuscinetto che si scalda non si vede",
            de="ein Lager, das heiß wird, bleibt unbemerkt",
        ),
    ),
    "sensor jumping": AlarmKind(
        subject="watched", priority=3, namur="out of specification",
        title=Phrase("sensor jumps", it="sensore a salti", de="Sensor springt"),
        past=Phrase("the sensor jumped", it="il sensore saltava", de="der Sensor sprang"),
        applies=_has_sensor,
        limit=yes_or_no,
        watches="steps between readings that no bearing can take",
        response=_LOOK_AT_SENSOR,
        consequence=Phrase(
            "single readings are wrong, as by a loose contact; the alarm at the limit may come in vain",
            it="singole letture sono errate, come per un contatto allentato; l'allarme al limite può scattare a vuoto",
            de="einzelne Messwerte sind falsch, wie bei einem Wackelkontakt; der Alarm an der Grenze kann "
            "grundlos kommen",
        ),
    ),
    "sensor noisy": AlarmKind(
        subject="watched", priority=3, namur="out of specification",
        title=Phrase("sensor noisy", it="sensore rumoroso", de="Sensor rauscht"),
        past=Phrase("the sensor was noisy", it="il sensore era rumoroso", de="der Sensor rauschte"),
        applies=_has_sensor,
        limit=yes_or_no,
        watches="the spread of the readings about a straight line through each three of them",
        response=_LOOK_AT_SENSOR,
        consequence=Phrase(
            "alarms come in vain, and the forecast begins from a wrong temperature",
            it="gli allarmi scattano a vuoto, e la previsione parte da una temperatura errata",
            de="Alarme kommen grundlos, und die Vorhersage beginnt bei einer falschen Temperatur",
        ),
    ),
    "sensor drifting": AlarmKind(
        subject="watched", priority=3, namur="maintenance required",
        title=Phrase("sensor drifts", it="sensore in deriva", de="Sensor driftet"),
        past=Phrase("the sensor drifted", it="il sensore derivava", de="der Sensor driftete"),
        applies=lambda at: _has_sensor(at) and at.config.twins[:1] == (at.tag,),
        limit=yes_or_no,
        watches="the difference to its twin bearing, against what that was before",
        response=Phrase(
            "compare {tag} and {twin} with a hand-held thermometer, then look at sensor, cable and input of the one "
            "that is wrong",
            it="confrontare {tag} e {twin} con un termometro portatile, poi controllare sensore, cavo e ingresso di "
            "quello che sbaglia",
            de="{tag} und {twin} mit einem Handthermometer vergleichen, dann Sensor, Kabel und Eingang dessen prüfen, "
            "der falsch anzeigt",
        ),
        consequence=Phrase(
            "the limit is reached later, or earlier, than it is seen",
            it="il limite si raggiunge prima o dopo di quanto si veda",
            de="die Grenze wird später oder früher erreicht, als man es sieht",
        ),
    ),
    "records": AlarmKind(
        subject="machine", bit=7,
        title=Phrase("records incomplete", it="registrazioni incomplete", de="Aufzeichnungen unvollständig"),
        past=Phrase(
            "the records were incomplete",
            it="le registrazioni erano incomplete",
            de="die Aufzeichnungen waren unvollständig",
        ),
        applies=always,
        limit=yes_or_no,
        finding=lambda signs: flag_value(signs.records_complaint),
        watches="whether historian, audit log and log take what happens",
        response=Phrase(
            "what happens may not be on record: see historian and parts in the status, and make room or mend the disk",
            it="ciò che accade potrebbe non essere registrato: vedere storico e parti nello stato, e fare spazio o "
            "riparare il disco",
            de="was geschieht, wird vielleicht nicht aufgezeichnet: siehe Historian und Teile im Status, und Platz "
            "schaffen oder die Platte instand setzen",
        ),
        consequence=Phrase(
            "what happens is lost, and an armed gateway disarms itself",
            it="ciò che accade va perso, e un gateway armato si disarma da solo",
            de="was geschieht, geht verloren, und ein scharfes Gateway entschärft sich selbst",
        ),
    ),
    "parts": AlarmKind(
        subject="machine", bit=7,
        title=Phrase(
            "a part of the gateway failed",
            it="una parte del gateway è caduta",
            de="ein Teil des Gateways ist ausgefallen",
        ),
        past=Phrase(
            "a part of the gateway had failed",
            it="una parte del gateway era caduta",
            de="ein Teil des Gateways war ausgefallen",
        ),
        applies=always,
        limit=yes_or_no,
        finding=lambda signs: flag_value(signs.failed_parts or signs.missing_parts),
        watches="parts of the gateway that failed and were begun anew, or could not be begun, as a model whose file is "
        "damaged",
        response=Phrase(
            "a part of the gateway failed or could not be begun: see parts in the status and the log, and report it",
            it="una parte del gateway è caduta o non si è potuta avviare: vedere le parti nello stato e il log, e "
            "segnalarlo",
            de="ein Teil des Gateways ist ausgefallen oder konnte nicht beginnen: siehe Teile im Status und das Log, "
            "und es melden",
        ),
        consequence=Phrase(
            "what that part does is late or missing",
            it="ciò che fa quella parte tarda o manca",
            de="was dieser Teil tut, kommt zu spät oder fehlt",
        ),
    ),
    "clock": AlarmKind(
        subject="machine", bit=8, priority=3,
        title=Phrase("clock wrong", it="orologio errato", de="Uhr falsch"),
        past=Phrase("the clock was wrong", it="l'orologio era errato", de="die Uhr ging falsch"),
        applies=always,
        limit=yes_or_no,
        finding=lambda signs: flag_value(signs.clock_complaint),
        watches="the clock, against the newest record, the monotonic clock and the PLC's (`clock.tag`)",
        response=Phrase(
            "the clock has jumped: set it and start the gateway anew; nothing is deleted by age meanwhile",
            it="l'orologio è saltato: regolarlo e riavviare il gateway; nel frattempo nulla viene cancellato per età",
            de="die Uhr ist gesprungen: sie stellen und das Gateway neu starten; bis dahin wird nichts nach Alter "
            "gelöscht",
        ),
        consequence=Phrase(
            "times in the records are wrong",
            it="gli orari nelle registrazioni sono errati",
            de="die Zeiten in den Aufzeichnungen sind falsch",
        ),
    ),
    "clock not steered": AlarmKind(
        subject="plant", priority=4, on_delay=3600.0,
        title=Phrase("clock not steered", it="orologio non sincronizzato", de="Uhr nicht gestellt"),
        past=Phrase(
            "the clock was not steered",
            it="l'orologio non era sincronizzato",
            de="die Uhr wurde nicht gestellt",
        ),
        applies=always,
        limit=yes_or_no,
        finding=_steering_sign,
        watches="whether a time server steers this computer's clock, by the kernel's own account",
        response=Phrase(
            "no time server steers the clock: see timedatectl, and have NTP set up; where there shall be none, "
            "switch this alarm off",
            it="nessun server orario regola l'orologio: vedere timedatectl e configurare NTP; dove non deve esserci, "
            "disattivare questo allarme",
            de="kein Zeitserver stellt die Uhr: siehe timedatectl und NTP einrichten; wo es keinen geben soll, diesen "
            "Alarm abschalten",
        ),
        consequence=Phrase(
            "the clock drifts by seconds a day, and times of this gateway and of others cannot be compared",
            it="l'orologio sbaglia di secondi al giorno, e gli orari di questo gateway e di altri non si "
            "possono confrontare",
            de="die Uhr geht um Sekunden am Tag falsch, und Zeiten dieses und anderer Gateways sind nicht vergleichbar",
        ),
    ),
    "link": AlarmKind(
        subject="machine", priority=1, on_delay=10.0,
        title=Phrase(
            "no connection to the machine",
            it="nessun collegamento con la macchina",
            de="keine Verbindung zur Maschine",
        ),
        past=Phrase(
            "there was no connection to the machine",
            it="mancava il collegamento con la macchina",
            de="es gab keine Verbindung zur Maschine",
        ),
        applies=always,
        limit=yes_or_no,
        finding=lambda signs: flag_value(not signs.link_alive),
        watches="whether good readings arrive at all",
        response=Phrase(
            "no good reading arrives: see link in the status, then look at network, cable and PLC",
            it="non arriva nessuna lettura valida: vedere il collegamento, poi controllare rete, cavo e PLC",
            de="es kommt kein guter Messwert an: siehe Verbindung, dann Netz, Kabel und SPS prüfen",
        ),
        consequence=Phrase(
            "the machine is not watched",
            it="la macchina non è sorvegliata",
            de="die Maschine wird nicht überwacht",
        ),
    ),
    "disk": AlarmKind(
        subject="plant",
        title=Phrase("disk nearly full", it="disco quasi pieno", de="Platte fast voll"),
        past=Phrase("the disk was nearly full", it="il disco era quasi pieno", de="die Platte war fast voll"),
        applies=always,
        limit=lambda _: 0.0,
        finding=_lacking_mb,
        watches="the room that is left where the records lie, against `alarms.disk_mb`",
        response=Phrase(
            "the disk is nearly full: make room, or lower historian.max_mb",
            it="il disco è quasi pieno: fare spazio, o ridurre historian.max_mb",
            de="die Platte ist fast voll: Platz schaffen oder historian.max_mb verringern",
        ),
        consequence=Phrase(
            "the oldest measurements go, and in the end nothing is on record",
            it="le misure più vecchie spariscono, e alla fine non si registra più nulla",
            de="die ältesten Messwerte gehen verloren, und am Ende wird nichts mehr aufgezeichnet",
        ),
    ),
    "certificate": AlarmKind(
        subject="machine", priority=3,
        title=Phrase("certificate runs out", it="certificato in scadenza", de="Zertifikat läuft ab"),
        past=Phrase("a certificate ran out", it="un certificato era in scadenza", de="ein Zertifikat lief ab"),
        applies=lambda at: bool(at.config.certificate_folders),
        limit=lambda at: -at.config.alarms.certificate_days,
        finding=lambda signs: None if signs.certificate_days is None else -signs.certificate_days,
        watches="the days until a certificate of the link or of the OPC UA server runs out, against "
        "`alarms.certificate_days`",
        response=Phrase(
            "a certificate of the link or of the OPC UA server runs out: have a new one made and put in its place",
            it="un certificato del collegamento o del server OPC UA sta per scadere: farne fare uno nuovo e metterlo "
            "al suo posto",
            de="ein Zertifikat der Verbindung oder des OPC-UA-Servers läuft ab: ein neues machen lassen und an seine "
            "Stelle legen",
        ),
        consequence=Phrase(
            "from that day on the PLC refuses the gateway and the machine is not watched, or the clients of "
            "the OPC UA server refuse it and see nothing",
            it="da quel giorno il PLC rifiuta il gateway e la macchina non è sorvegliata, oppure i client del "
            "server OPC UA lo rifiutano e non vedono nulla",
            de="von dem Tag an weist die SPS das Gateway ab und die Maschine wird nicht überwacht, oder die "
            "Clients des OPC-UA-Servers weisen es ab und sehen nichts",
        ),
    ),
    "notification": AlarmKind(
        subject="plant", priority=3,
        title=Phrase("messages not delivered", it="messaggi non recapitati", de="Meldungen nicht zugestellt"),
        past=Phrase(
            "messages were not delivered",
            it="i messaggi non venivano recapitati",
            de="Meldungen wurden nicht zugestellt",
        ),
        applies=lambda at: bool(at.config.notify.to),
        limit=yes_or_no,
        finding=lambda signs: flag_value(signs.undelivered),
        watches="whether messages about alarms are delivered",
        response=Phrase(
            "messages about alarms are not delivered: see the log for the recipient, then mail server or web hook",
            it="i messaggi sugli allarmi non vengono recapitati: vedere nel log il destinatario, poi il server di "
            "posta o il web hook",
            de="Meldungen über Alarme werden nicht zugestellt: siehe im Log den Empfänger, dann Mailserver oder "
            "Web-Hook",
        ),
        consequence=Phrase(
            "nobody who is away from the page hears of an alarm",
            it="chi è lontano dalla pagina non sa degli allarmi",
            de="wer nicht vor der Seite sitzt, erfährt von keinem Alarm",
        ),
    ),
    "northbound": AlarmKind(
        subject="plant", priority=3, on_delay=300.0,
        title=Phrase(
            "other systems out of reach",
            it="altri sistemi non raggiungibili",
            de="andere Systeme nicht erreichbar",
        ),
        past=Phrase(
            "other systems were out of reach",
            it="altri sistemi non erano raggiungibili",
            de="andere Systeme waren nicht erreichbar",
        ),
        applies=lambda at: bool(at.config.northbound.sinks),
        limit=yes_or_no,
        finding=lambda signs: flag_value(signs.unreached),
        watches="whether the brokers and databases that are told what is on record can be reached",
        response=Phrase(
            "a broker or database is out of reach: see the log for which one and why, then network and server",
            it="un broker o database non è raggiungibile: vedere nel log quale e perché, poi rete e server",
            de="ein Broker oder eine Datenbank ist nicht erreichbar: siehe im Log welche und warum, dann Netz "
            "und Server",
        ),
        consequence=Phrase(
            "other systems show old values, and what is older than northbound.backlog_hours never comes there",
            it="altri sistemi mostrano valori vecchi, e ciò che è più vecchio di northbound.backlog_hours non "
            "vi arriva mai",
            de="andere Systeme zeigen alte Werte, und was älter ist als northbound.backlog_hours, kommt dort nie an",
        ),
    ),
    "another writer": AlarmKind(
        subject="machine", bit=6, priority=1,
        title=Phrase("another gateway writes", it="scrive un altro gateway", de="ein anderes Gateway schreibt"),
        past=Phrase("another gateway wrote", it="scriveva un altro gateway", de="ein anderes Gateway schrieb"),
        applies=lambda at: at.config.map.writeback is not None and at.config.writeback.mode != "off",
        limit=yes_or_no,
        finding=lambda signs: None if signs.rival is None else flag_value(signs.rival),
        watches="the PLC's word of another gateway that writes its blocks",
        response=Phrase(
            "another gateway writes to this PLC: other_writer in the status is its number, writer is this one's; "
            "find it and disarm one of the two",
            it="un altro gateway scrive su questo PLC: other_writer nello stato è il suo numero, writer quello di "
            "questo; trovarlo e disarmare uno dei due",
            de="ein anderes Gateway schreibt in diese SPS: other_writer im Status ist seine Nummer, writer die von "
            "diesem; es finden und eines der beiden entschärfen",
        ),
        consequence=Phrase(
            "the PLC takes the other one's blocks, or nobody's",
            it="il PLC accetta i blocchi dell'altro, o di nessuno",
            de="die SPS nimmt die Blöcke des anderen an, oder keine",
        ),
    ),
    "device": AlarmKind(
        subject="machine", bit=6,
        title=Phrase(
            "the device reports a fault",
            it="il dispositivo segnala un guasto",
            de="das Gerät meldet eine Störung",
        ),
        past=Phrase(
            "the device reported a fault",
            it="il dispositivo segnalava un guasto",
            de="das Gerät meldete eine Störung",
        ),
        applies=lambda at: at.complains,
        limit=yes_or_no,
        finding=lambda signs: flag_value(signs.complaints),
        watches="what the device itself says is wrong with it (as by EMCY)",
        response=Phrase(
            "the device or its bus says that something is wrong: see complaints in the status",
            it="il dispositivo o il suo bus segnala un guasto: vedere le segnalazioni nello stato",
            de="das Gerät oder sein Bus meldet eine Störung: siehe die Meldungen im Status",
        ),
        consequence=Phrase(
            "readings may fail or be wrong",
            it="le letture possono mancare o essere errate",
            de="Messwerte können ausfallen oder falsch sein",
        ),
    ),
    "inputs bad": AlarmKind(
        subject="machine", bit=4,
        title=Phrase("readings bad", it="letture non valide", de="Messwerte schlecht"),
        past=Phrase("readings were bad", it="le letture non erano valide", de="Messwerte waren schlecht"),
        applies=always,
        limit=yes_or_no,
        more=_inputs,
        finding=_worst_input,
        watches="whether the readings that a model needs, or that are watched, are good",
        response=Phrase(
            "readings are old or bad: see values and link in the status, then look at PLC and cable",
            it="le letture sono vecchie o non valide: vedere valori e collegamento, poi controllare PLC e cavo",
            de="Messwerte sind alt oder schlecht: siehe Werte und Verbindung, dann SPS und Kabel prüfen",
        ),
        consequence=Phrase(
            "nothing is predicted, and a temperature over its limit may not be seen",
            it="non si prevede nulla, e una temperatura oltre il limite può passare inosservata",
            de="es wird nichts vorhergesagt, und eine Temperatur über der Grenze kann unbemerkt bleiben",
        ),
    ),
}  # fmt: skip
"""Every kind by its name, in the order in which they are shown."""

PLANT = "plant"
"""What an alarm of the whole plant names in place of a tag, where there are several machines."""
OF_PLANT = frozenset(name for name, kind in ALARM_KINDS.items() if kind.subject == "plant")
"""The kinds that a plant has once, whatever its machines: its first machine looks after them."""


def alarm_subject(alarm: str, tag: str, machine: str) -> str:
    """Whose an alarm is that names a tag: PLANT for one of a plant of several machines, else the machine.

    Rows on record from before a plant had such an alarm once name the machine, and are its.
    """
    return PLANT if alarm in OF_PLANT and tag == PLANT else machine


def parse_kind(alarm: str) -> str:
    """The kind of an alarm by its name, which may have a tag behind it; "" for one that is in no table."""
    return max((kind for kind in ALARM_KINDS if f"{alarm} ".startswith(f"{kind} ")), key=len, default="")


Priority = Annotated[int, Field(ge=MOST_URGENT, le=LEAST_URGENT)]


class AlarmRow(Section):
    """`[[alarm]]`: what is other than by default of one kind of alarms, on all tags or on one. Later rows count more.

    What is not given stays as it is.
    """

    name: str = Field(description="the name of a kind of alarm, as `decanter alarm list` shows it without the tag")
    tag: str | None = Field(None, description="the tag of one temperature; all without this key")
    enabled: bool | None = Field(None, description="true or false: whether there is such an alarm at all")
    priority: Priority | None = Field(
        None, description=f"a priority from {MOST_URGENT}, the most urgent, to {LEAST_URGENT}"
    )
    deadband: float | None = Field(None, ge=0, description="by how much it must fall below its limit to be over")
    on_delay: float | None = Field(None, ge=0, description="seconds that it must stand before it is raised")
    off_delay: float | None = Field(None, ge=0, description="seconds that it must be over before it returns")
    response: Line | None = Field(None, description="one line of what an operator shall do")
    consequence: Line | None = Field(None, description="one line of what comes of not doing it")
    latch: bool | None = Field(None, description="true: it stays until it is reset, false: it goes by itself")
    suppressed_by: str | None = Field(
        None, description="'TAG' or 'TAG=0': the alarm is suppressed while that tag is not 0 (is 0)"
    )

    @field_validator("name")
    @classmethod
    def _a_kind(cls, name: str) -> str:
        if name not in ALARM_KINDS:
            guess = did_you_mean(name, list(ALARM_KINDS))
            raise ValueError(f"there is no alarm {name[:60]!r}; {guess or 'give one of ' + ', '.join(ALARM_KINDS)}")
        return name

    @field_validator("suppressed_by")
    @classmethod
    def _tag_and_value(cls, text: str | None) -> str | None:
        if text is not None and (not parse_suppression(text)[0] or text.partition("=")[2] not in ("", "0", "1")):
            raise ValueError(f"{text[:60]!r} is neither 'TAG', 'TAG=1' nor 'TAG=0'; give the name of a tag")
        return text


def parse_suppression(text: str) -> tuple[str, float]:
    """The tag of a `suppressed_by`, and the value (0 or 1 for anything else) by which it suppresses."""
    tag, _, value = text.partition("=")
    return tag, 0.0 if value == "0" else 1.0


def merge_settings(rows: Iterable[AlarmRow], kind: str, tag: str = "") -> dict[str, Any]:
    """What the rows say of a kind's alarm on a tag ("": of the machine), key by key; a later row goes over a former."""
    found: dict[str, Any] = {}
    for row in rows:
        if row.name == kind and row.tag in (None, tag):
            found |= row.model_dump(exclude_none=True, exclude={"name", "tag"})
    return found


def alarm_problems(
    rows: Iterable[AlarmRow], tags: Iterable[str], watched: Iterable[str], predicted: Iterable[str], file: object
) -> list[str]:
    """What no single key of the rows shows: tags that are not there, or of which there is no such alarm."""
    known, problems = set(tags), []
    of = {"watched": list(watched), "predicted": list(predicted), "machine": list[str](), "plant": list[str]()}
    for place, row in enumerate(rows):
        subjects = of[ALARM_KINDS[row.name].subject]
        if row.tag is not None and row.tag not in subjects:
            whose = ALARM_KINDS[row.name].subject
            right = f"give one of {', '.join(subjects)}" if subjects else f"leave the key out: it is the {whose}'s"
            problems.append(f"alarm[{place}].tag: there is no alarm {row.name!r} of {row.tag!r}; {right}")
        if row.suppressed_by is not None and (tag := parse_suppression(row.suppressed_by)[0]) not in known:
            right = did_you_mean(tag, known) or "give one of its names"
            problems.append(f"alarm[{place}].suppressed_by: {tag!r} is not a tag of {file}; {right}")
    return problems
