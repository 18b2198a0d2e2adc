"""A model that is promoted while the gateway runs: noticed, verified and made ready beside the scans, then taken over.

Only where `model.path` is a store. Its promotion is looked at every few seconds in a thread. A new current version is
judged as at a start (`gateway.machine.model.loading`), and followed over the recent scans, so that it knows the
location and the stay when it takes over. One that is refused changes nothing: the former model goes on, and it is not
tried again until something is promoted anew.
"""

import asyncio
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import inf

from drivers.settings import ConfigError
from drivers.supervision import Supervisor
from gateway.machine.model.ensemble import FAULTS
from gateway.machine.model.loading import LoadedModel, load_model
from gateway.machine.model.predict import Predictor
from gateway.machine.reading import Scan
from gateway.settings import Config
from sim.artefacts import current, promotion
from sim.files import ArtefactError

POLL_SECONDS = 2.0
"""Plant seconds between two looks at the store."""
RECENT_SCANS = 300
"""The newest scans, which a new model is followed over."""


@dataclass(frozen=True, slots=True)
class ReadyModel:
    """A model that may take over; its `predictor` has followed the scans up to the time `until` (plant s)."""

    loaded: LoadedModel
    predictor: Predictor
    until: float


@dataclass(frozen=True, slots=True)
class RefusedPromotion:
    """A promoted model that is not run, and the sentence why."""

    reason: str


LookResult = ReadyModel | RefusedPromotion | None


class Pickup:
    """Looks for another current version in the configured store; at most one look goes on at a time.

    `ready` is a model that waits until it is `take`, `refused` why the newest promotion is not run ("": it is).
    """

    def __init__(self, config: Config, running: LoadedModel | None, supervisor: Supervisor | None = None) -> None:
        self.config = config
        self._supervisor = supervisor or Supervisor()
        self.running = running.version if running is not None else ""
        self.ready: ReadyModel | None = None
        self.refused = ""
        self._seen: object = None
        self._recent: deque[Scan] = deque(maxlen=RECENT_SCANS)
        self._task: asyncio.Task[tuple[object, LookResult]] | None = None
        self._due = -inf

    def keep(self, scan: Scan) -> None:
        """Remember a scan for the models to come; nothing where none can come."""
        if self.running:
            self._recent.append(scan)

    def look(self, now: float, members: Sequence[str]) -> None:
        """Begin a look at the store if one is due; `members` are the hashes of the ensemble's other models."""
        if not self.running or self._task is not None or self.ready is not None or now < self._due:
            return
        self._due = now + POLL_SECONDS
        # Copies, since the scans of the meantime go into the originals while the thread looks.
        work = partial(_look, self.config, self._seen, self.running, members=tuple(members), recent=tuple(self._recent))
        self._task = self._supervisor.job("look for another model", work)

    def collect(self) -> str:
        """Take in a finished look: it may set `ready`. The sentence of a refusal is given back, once; "" else."""
        if self._task is None or not self._task.done():
            return ""
        task, self._task = self._task, None
        before = self._seen
        self._seen, result = task.result()
        # Only another promotion changes what is said of the newest one: a look that saw the same says nothing.
        if self._seen != before:
            self.refused = result.reason if isinstance(result, RefusedPromotion) else ""
        self.ready = result if isinstance(result, ReadyModel) else None
        return result.reason if isinstance(result, RefusedPromotion) else ""

    def take(self) -> ReadyModel | str | None:
        """The model that waits, brought to the newest scan; the sentence why it is refused; None where none waits."""
        ready, self.ready = self.ready, None
        if ready is None:
            return None
        try:
            # It was made ready beside the scans: those since then are still to be followed.
            _follow(ready.predictor, [scan for scan in self._recent if scan.time > ready.until])
        except FAULTS as error:
            self.refused = _failure_sentence(ready.loaded, error)
            return self.refused
        self.running = ready.loaded.version
        return ready

    async def close(self) -> None:
        """Wait for the look that goes on; what it finds is dropped."""
        if self._task is not None:
            await asyncio.gather(self._task, return_exceptions=True)
            self._task = None


def _look(
    config: Config, seen: object, running: str, *, members: Sequence[str], recent: Sequence[Scan]
) -> tuple[object, LookResult]:
    """(the promotion that was looked at, what is to be done about it: nothing where it was `seen` or is `running`)."""
    store = config.model.path
    stamp = None if store is None else promotion(store)
    if store is None or stamp == seen:
        return stamp, None
    # The configured model as at a start, and following the recent scans.
    try:
        loaded = None if current(store) == running else load_model(config)
    except ConfigError as error:
        return stamp, RefusedPromotion(error.in_one_line)
    except ArtefactError as error:
        return stamp, RefusedPromotion(str(error))
    if loaded is None:
        return stamp, None
    if loaded.hash in members:
        reason = f"version {loaded.version} is the same model as one of ensemble.members; give each model once"
        return stamp, RefusedPromotion(reason)
    predictor = Predictor(loaded.model, config.model.temperature)
    try:
        _follow(predictor, recent)
    except FAULTS as error:
        return stamp, RefusedPromotion(_failure_sentence(loaded, error))
    return stamp, ReadyModel(loaded, predictor, recent[-1].time if recent else -inf)


def _follow(predictor: Predictor, scans: Sequence[Scan]) -> None:
    for scan in scans:
        predictor.step(scan)


def _failure_sentence(loaded: LoadedModel, error: Exception) -> str:
    return f"version {loaded.version} fails on the plant's recent readings: {error!r}; see that it suits the plant"
