"""Several links to one device as one driver: all are read, one is believed, and a better one takes over.

Every scan reads every link that is free and takes all its samples from one of them, so that a tag has one sample a
scan. The active link is left for another when it has not answered after `switch_after`, when more of its tags fail in
the link than the other's, or when its heartbeat stands still while the other's moves. That takes one scan, so no
reading is lost as long as the other link is well. A link higher up in the list is used again once it has been well for
`return_after` without a break.

What keeps events from being lost or doubled: a sample that may be older than the last one of the same tag from another
link is not taken; the last one stands until a newer arrives. What keeps another PLC from being taken for this one: the
heartbeats of two links must be the same count at the same time (`gateway.machine.reading.same_plc`).

A block goes out over the active link only. If its fate is not known, it is read back over another link; it is never
sent again.
"""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from drivers.driver import BeforeSending, Cautions, Complains, Driver, Explains, PlanLine, Supervised, Writes, anyhow
from drivers.errors import AddressError, DeviceException, DriverError, EncodingError, LinkDown, WriteForbidden
from drivers.supervision import Supervisor
from drivers.tag import Quality, Sample, Tag, Value
from gateway.machine.reading.quality import LINK_FAULTS
from gateway.machine.reading.same_plc import Pulse, agree, still, with_beat

# Errors after which it is certain that the device did not take the block: nothing was sent, or it refused.
_KNOWN_FATE = (WriteForbidden, EncodingError, AddressError, DeviceException)
_MAX_FOREIGN_BEATS = 3
"""Scans running with another heartbeat before a link is taken to lead to another PLC."""


@dataclass(frozen=True, slots=True)
class RedundantPath:
    """One link: its driver, and the tags by name with this link's own addresses (those that may be written too)."""

    name: str
    driver: Driver
    tags: Mapping[str, Tag]


@dataclass(frozen=True, slots=True)
class RedundancyRules:
    """`switch_after`, `return_after` (real s); `heartbeat`, the tag; `beat_period`, the clock's seconds between two."""

    switch_after: float
    return_after: float
    heartbeat: str | None
    beat_period: float


@dataclass(frozen=True, slots=True)
class SwitchOver:
    """One change of the active link at `time` (the clock's), why, and the real seconds that the scan waited for it."""

    time: float
    before: str
    after: str
    reason: str
    waited: float


@dataclass(slots=True)
class _PathState:
    """What is known of one link.

    `samples` are its last complete reading: `fresh` if that was completed in this scan, `news` if it was since the last
    judgement (a link slower than the active one is complete after the scan that asked for it).
    """

    path: RedundantPath
    task: "asyncio.Task[list[Sample]] | None" = None
    samples: Mapping[str, Sample] = field(default_factory=dict)
    fresh: bool = False
    news: bool = False
    pulse: Pulse = field(default_factory=Pulse)
    strange: int = 0
    well_since: float | None = None
    reason: str = ""

    @property
    def faults(self) -> int:
        """How many of the last readings failed in the link."""
        return sum(sample.quality in LINK_FAULTS for sample in self.samples.values())


class Redundant:
    """A Driver that Writes, over several links; the first is the primary. `clock` gives the samples' time."""

    def __init__(self, paths: Sequence[RedundantPath], rules: RedundancyRules, clock: Callable[[], float]) -> None:
        self._states = [_PathState(path) for path in paths]
        self._rules, self._clock = rules, clock
        self._active = 0
        self._last: dict[str, tuple[int, Sample]] = {}
        self._counts = dict.fromkeys(("switch_overs", "returns", "held_samples", "confirmed_elsewhere"), 0)
        self.on_switch: Callable[[SwitchOver], None] = lambda _: None
        self.supervisor = Supervisor()
        for path in paths:
            if isinstance(path.driver, Supervised):
                self.supervisor.include(path.name, path.driver.supervisor)

    # ------------------------------------------------------------ Driver

    async def open(self) -> None:
        """Open all links at once. Raises LinkDown if none could be opened (all go on trying)."""
        drivers = [state.path.driver for state in self._states]
        outcomes = await asyncio.gather(*(driver.open() for driver in drivers), return_exceptions=True)
        reasons = []
        for state, outcome in zip(self._states, outcomes, strict=True):
            if isinstance(outcome, DriverError):
                state.reason = str(outcome)
                reasons.append(f"{state.path.name}: {outcome}")
            elif outcome is not None:
                raise outcome
        if len(reasons) == len(self._states):
            raise LinkDown("; ".join(reasons))

    async def close(self) -> None:
        """Close all links. Never raises; may be called twice."""
        tasks = [state.task for state in self._states if state.task is not None]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        for state in self._states:
            state.task = None
            await state.path.driver.close()

    @property
    def connected(self) -> bool:
        """True while the active link is."""
        return self._states[self._active].path.driver.connected

    def statistics(self) -> Mapping[str, float]:
        """Changes of the link, samples held back, blocks confirmed over another link; then each link's own counters."""
        own: dict[str, float] = {**self._counts, "active": self._active}
        for state in self._states:
            own |= {f"{state.path.name}: {key}": value for key, value in state.path.driver.statistics().items()}
        return own

    def explain(self, tags: Sequence[Tag]) -> tuple[PlanLine, ...]:
        """The plan of each link in sentences."""
        lines: list[PlanLine] = []
        for state in self._states:
            driver = state.path.driver
            plan = driver.explain([state.path.tags[tag.name] for tag in tags]) if isinstance(driver, Explains) else ()
            lines += [PlanLine(f"{state.path.name}: {line}", line.kind) for line in plan]
        return tuple(lines)

    def cautions(self) -> tuple[str, ...]:
        """What should not stay as it is on any link."""
        drivers = (state.path.driver for state in self._states)
        return tuple(lines for driver in drivers if isinstance(driver, Cautions) for lines in driver.cautions())

    def complaints(self) -> tuple[str, ...]:
        """What the device says is wrong with it, over any link that can say so."""
        drivers = (state.path.driver for state in self._states)
        return tuple(lines for driver in drivers if isinstance(driver, Complains) for lines in driver.complaints())

    def report(self) -> list[dict[str, Any]]:
        """Each link as plain values: its name, whether it is active, connected and well, and why not."""
        return [
            {
                "name": state.path.name,
                "active": index == self._active,
                "connected": state.path.driver.connected,
                "well": state.well_since is not None,
                "reason": "" if state.well_since is not None else state.reason,
            }
            for index, state in enumerate(self._states)
        ]

    async def read(self, tags: Sequence[Tag]) -> list[Sample]:
        """Read all links, and give the samples of the one that is believed; a failure is a sample of bad quality."""
        begun = _now()
        for state in self._states:
            # A link whose last reading still runs is not asked again: it would only fall behind further.
            self._collect(state)
            state.fresh = False
            if state.task is None:
                own = [state.path.tags[tag.name] for tag in tags]
                state.task = asyncio.create_task(state.path.driver.read(own), name=f"read {state.path.name}")
        await self._await_links(begun)
        self._judge()
        self._choose(begun)
        return [self._pick_sample(tag.name) for tag in tags]

    # ------------------------------------------------------------ one scan

    def _collect(self, state: _PathState) -> None:
        """Take over the link's reading if it is complete."""
        if state.task is not None and state.task.done():
            task, state.task = state.task, None
            state.samples, state.fresh, state.news = {sample.tag: sample for sample in task.result()}, True, True
            state.pulse = with_beat(state.pulse, state.samples.get(self._rules.heartbeat or ""))

    async def _await_links(self, begun: float) -> None:
        """Wait for the active link; if it fails or is late, for the first other one that is well, or for all."""
        until = begun + self._rules.switch_after
        # First only the active link, for as long as it may take: that is the scan of every ordinary day.
        await self._wait([self._states[self._active]], until)
        while not any(state.fresh and self._is_well(state) for state in self._states):
            if not await self._wait(self._states, None):
                break
        # A link that may be returned to has to be complete in the scan that returns to it; it gets what is left of the
        # time, and no more, since the one that is used now has answered.
        if (due := self._due()) is not None and not due.fresh:
            await self._wait([due], until)
        for state in self._states:
            self._collect(state)

    def _due(self) -> _PathState | None:
        """The link above the active one that has been well long enough to be used again, if any."""
        moment, above = _now(), self._states[: self._active]
        well = (state for state in above if state.well_since is not None)
        return next((s for s in well if moment - (s.well_since or moment) >= self._rules.return_after), None)

    async def _wait(self, states: Sequence[_PathState], until: float | None) -> bool:
        """Wait for the next of the links' readings, at most to the loop's time `until`; False if none runs."""
        running = {state.task for state in states if state.task is not None}
        left = None if until is None else until - _now()
        if running and (left is None or left > 0):
            await asyncio.wait(running, timeout=left, return_when=asyncio.FIRST_COMPLETED)
        for state in states:
            self._collect(state)
        return bool(running)

    def _is_well(self, state: _PathState) -> bool:
        """True if all tags came through the link with its last reading, and it shows our PLC, which lives."""
        if not state.samples or state.faults or state.strange >= _MAX_FOREIGN_BEATS:
            return False
        return not still(state.pulse, self._rules.beat_period)

    def _judge(self) -> None:
        """Bring the account of every link up to date that has news, and of the active one in any case."""
        moment = _now()
        # Heartbeats first, since a link that is not our PLC is not well. Compared only where both have something new:
        # an old count against a new one differs by itself. What cannot be told (None) changes no count.
        active = self._states[self._active]
        for state in self._states:
            if state is not active and state.news and active.news:
                same = agree(active.pulse, state.pulse)
                if same is not None:
                    state.strange = 0 if same else state.strange + 1
        for index, state in enumerate(self._states):
            if index == self._active and not state.fresh:
                state.well_since, state.reason = None, f"no answer within {self._rules.switch_after:g} s"
            elif state.news and self._is_well(state):
                state.well_since, state.reason = state.well_since or moment, ""
            elif state.news:
                state.well_since = None
                if state.faults:
                    state.reason = next(s.reason for s in state.samples.values() if s.quality in LINK_FAULTS)
                elif still(state.pulse, self._rules.beat_period):
                    state.reason = "its heartbeat stands still"
                else:
                    state.reason = "its heartbeat is another one: it leads to another PLC, or to a copy of old values"
            state.news = False

    def _choose(self, begun: float) -> None:
        """Let another link take over if it is better now, or if it comes first and has been well long enough."""
        active = self._states[self._active]
        # The way back before the way out: a primary that has been well long enough is the better of any two.
        due = self._due()
        if due is not None and due.fresh:
            self._counts["returns"] += 1
            reason = f"{due.path.name} has been well for {self._rules.return_after:g} s"
            self._switch(self._states.index(due), reason, begun)
            return
        if active.well_since is not None:
            return
        others = [index for index, state in enumerate(self._states) if self._is_better(state, active)]
        if others:
            self._counts["switch_overs"] += 1
            self._switch(others[0], f"{active.path.name}: {active.reason}", begun)

    def _is_better(self, state: _PathState, active: _PathState) -> bool:
        if state is active or not state.fresh or state.strange >= _MAX_FOREIGN_BEATS:
            return False
        if self._is_well(state):
            return True
        # None is well: the one by which more tags come through, and at least one, is still the better.
        return state.faults < len(state.samples) and (not active.fresh or state.faults < active.faults)

    def _switch(self, index: int, reason: str, begun: float) -> None:
        before, self._active = self._active, index
        names = self._states[before].path.name, self._states[index].path.name
        self.on_switch(SwitchOver(self._clock(), *names, reason, _now() - begun))

    def _pick_sample(self, name: str) -> Sample:
        """The active link's sample of a tag, or the last one of another link if that may be the newer."""
        state = self._states[self._active]
        sample = state.samples.get(name) if state.fresh else None
        if sample is None:
            reason = f"{state.path.name}: {state.reason or 'not read yet'}"
            return Sample(name, None, Quality.TIMEOUT, self._clock(), reason=reason)
        before = self._last.get(name)
        if sample.value is None:
            return sample
        # Two links see the device at different moments: one that looked before the other's last reading would take an
        # event back and bring it again. The device looked at some moment from the request's sending to its reply; the
        # earliest of these is what the sample can be held to.
        earliest = sample.time if sample.sent is None else sample.sent
        if before is not None and before[0] != self._active and earliest < before[1].time:
            self._counts["held_samples"] += 1
            return before[1]
        self._last[name] = (self._active, sample)
        return sample

    # ------------------------------------------------------------ Writes

    async def write(self, values: Sequence[tuple[Tag, Value]], *, before_sending: BeforeSending = anyhow) -> None:
        """Write all values over the active link, once; if their fate is not known, read them back over another.

        Raises as the link's driver does, but not where another link shows that the device holds what was written.
        """
        active = self._states[self._active]
        driver = active.path.driver
        if not isinstance(driver, Writes):
            raise WriteForbidden(f"{active.path.name} cannot write; nothing was sent")
        try:
            await driver.write([(_own(active, tag), value) for tag, value in values], before_sending=before_sending)
        except _KNOWN_FATE:
            raise
        except DriverError as error:
            if not await self._stands(values, active):
                raise
            self._counts["confirmed_elsewhere"] += 1
            active.reason = str(error)

    async def _stands(self, values: Sequence[tuple[Tag, Value]], active: _PathState) -> bool:
        """True if another link that is well, and knows all of the tags, shows the values in the device."""
        for state in self._states:
            if state is active or state.well_since is None or any(tag.name not in state.path.tags for tag, _ in values):
                continue
            own = [_own(state, tag) for tag, _ in values]
            samples = await state.path.driver.read(own)
            expected = zip(own, samples, (value for _, value in values), strict=True)
            return all(_holds(tag, sample, value) for tag, sample, value in expected)
        return False


# ---------------------------------------------------------------- without state


def _now() -> float:
    return asyncio.get_running_loop().time()


def _own(state: _PathState, tag: Tag) -> Tag:
    own = state.path.tags.get(tag.name)
    if own is None:
        raise WriteForbidden(f"{tag.name} has no address on {state.path.name}; nothing was sent")
    return own


def _holds(tag: Tag, sample: Sample, value: Value) -> bool:
    if not sample.quality.is_good or sample.value is None:
        return False
    if isinstance(value, str) or isinstance(sample.value, str):
        return sample.value == value
    # The register holds whole counts: what was written was rounded by up to half of one.
    return abs(float(sample.value) - float(value)) <= abs(tag.scale) / 2
