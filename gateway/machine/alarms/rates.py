"""How many alarms an operator is asked to deal with, against what EEMUA 191 and ISA-18.2 say a person can.

An alarm is counted each time it is announced: it comes into the state "unacknowledged". All is exact: ten minutes are
any ten minutes, (t - 600 s, t], and not those of a calendar.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from gateway.machine.alarms.journal import JournalRow
from gateway.machine.alarms.states import ACTIVE, AlarmState

TEN_MINUTES = 600.0
ACCEPTABLE, MANAGEABLE, OVERLOADED = 1.0, 2.0, 5.0
"""Alarms in ten minutes on average (EEMUA 191, edition 3): to 1 very likely acceptable, to 2 manageable, to 5 likely
over-demanding, beyond that very likely unacceptable."""
MAX_ALARMS_IN_TEN_MINUTES = 10
"""The most alarms in any ten minutes that a person can deal with (ISA-18.2, table 7)."""
FLOOD_BEGIN_COUNT, FLOOD_END_COUNT = 10, 5
"""A flood begins with more than 10 alarms within ten minutes and ends when they are fewer than 5."""
MIN_CHATTER_COUNT, CHATTER_SECONDS = 3, 60.0
"""An alarm that is announced so often within a minute chatters."""
STALE_SECONDS = 86_400.0
"""An alarm that stands for longer than a day is stale."""
PRIORITIES: Mapping[int, float] = {1: 0.05, 2: 0.15, 3: 0.80, 4: 0.0}
"""The share of each priority that is advised (EEMUA 191: 5 % high, 15 % medium, 80 % low; 4 is below these)."""
SHARE_TOLERANCE = 2.0
"""The most urgent priority may have so many times its advised share before it is too many."""
MAX_LISTED_NAMES = 10


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmFlood:
    """A flood from `start` to `end` (s UTC), with all alarms announced from ten minutes before its start to its end."""

    start: float
    end: float
    alarms: int


@dataclass(frozen=True, slots=True, kw_only=True)
class AlarmRates:
    """The rates between `start` and `end` (s UTC).

    `per_ten_minutes` is the average, `peak` the most within any ten minutes, which were over at `peak_at`.
    `flooded` is the share of the time. `chattering` has the most announcements within a minute by alarm, `standing` how
    long (s) each alarm has stood at the end, `stale` those of them that have stood too long, `frequent` the alarms that
    were announced most. `shares` are of the priorities. `verdict` is EEMUA's word for the average, `ok` whether
    everything is within what a person can deal with; `findings` says in sentences what is not.
    """

    start: float
    end: float
    announced: int
    per_ten_minutes: float
    verdict: str
    peak: int
    peak_at: float | None
    floods: Sequence[AlarmFlood]
    flooded: float
    chattering: Mapping[str, int]
    standing: Mapping[str, float]
    stale: Mapping[str, float]
    frequent: Mapping[str, int]
    priorities: Mapping[int, int]
    shares: Mapping[int, float]
    findings: Sequence[str]

    @property
    def ok(self) -> bool:
        """Whether nothing was found."""
        return not self.findings


def alarm_rates(rows: Iterable[JournalRow], start: float, end: float) -> AlarmRates:
    """The rates of announcements with start < time <= end; rows of before say what stood already.

    Raises ValueError unless the end is after the start.
    """
    if not end > start:
        raise ValueError("rates need a time: the end must be after the start")
    known = sorted((row for row in rows if row.time <= end), key=lambda row: row.time)
    several = len({row.machine for row in known}) > 1
    names = [f"{row.subject}: {row.alarm}" if several else row.alarm for row in known]
    fresh = [
        (name, row)
        for name, row in zip(names, known, strict=True)
        if row.time > start and row.state == AlarmState.UNACKNOWLEDGED
    ]
    times = [row.time for _, row in fresh]
    peak, peak_at = densest_window(times, TEN_MINUTES)
    floods = alarm_floods(times, end)
    standing = _standing_ages(zip(names, known, strict=True), end)
    by_name = defaultdict(list)
    for name, row in fresh:
        by_name[name].append(row.time)
    most = {name: densest_window(own, CHATTER_SECONDS)[0] for name, own in by_name.items()}
    chattering = {name: count for name, count in most.items() if count >= MIN_CHATTER_COUNT}
    stale = {name: seconds for name, seconds in standing.items() if seconds > STALE_SECONDS}
    priorities = Counter(row.priority for _, row in fresh)
    average = len(fresh) * TEN_MINUTES / (end - start)
    shares = {priority: count / len(fresh) for priority, count in sorted(priorities.items())}
    findings = []
    if average > ACCEPTABLE:
        findings.append(f"{average:.2g} alarms in ten minutes on average; more than {ACCEPTABLE:g} is too many")
    if peak > MAX_ALARMS_IN_TEN_MINUTES:
        findings.append(f"{peak} alarms within ten minutes; nobody can deal with more than {MAX_ALARMS_IN_TEN_MINUTES}")
    if floods:
        findings.append(f"{len(floods)} flood{'s' if len(floods) > 1 else ''} of alarms")
    if chattering:
        findings.append(f"chattering: {', '.join(chattering)}; give them a delay or a deadband")
    if stale:
        findings.append(f"standing for more than a day: {', '.join(stale)}; mend it, or take the alarm out of service")
    # A share says something only where there are enough alarms for one of the priority to be no whole share.
    advised = SHARE_TOLERANCE * PRIORITIES[1]
    if len(fresh) >= 1.0 / PRIORITIES[1] and shares.get(1, 0.0) > advised:
        findings.append(f"{shares[1]:.0%} of the alarms have priority 1; of many alarms that are urgent none is")
    return AlarmRates(
        start=start,
        end=end,
        announced=len(fresh),
        per_ten_minutes=average,
        verdict=_verdict(average),
        peak=peak,
        peak_at=peak_at,
        floods=floods,
        flooded=sum(min(flood.end, end) - flood.start for flood in floods) / (end - start),
        chattering=chattering,
        standing=standing,
        stale=stale,
        frequent=dict(Counter(name for name, _ in fresh).most_common(MAX_LISTED_NAMES)),
        priorities=dict(sorted(priorities.items())),
        shares=shares,
        findings=findings,
    )


def densest_window(times: Sequence[float], seconds: float) -> tuple[int, float | None]:
    """The most of the ascending `times` (s) in any (t - seconds, t], and the first such t; 0 and None without any."""
    window: deque[float] = deque()
    most, at = 0, None
    for time in times:
        window.append(time)
        while window[0] <= time - seconds:
            window.popleft()
        if len(window) > most:
            most, at = len(window), time
    return most, at


def alarm_floods(times: Sequence[float], end: float) -> list[AlarmFlood]:
    """The floods among announcements at ascending `times` (s); one that has not ended by then ends at `end`."""
    floods: list[AlarmFlood] = []
    window: deque[float] = deque()
    start, count = None, 0
    # Each alarm comes at its time and leaves the ten minutes 600 s later; what leaves at a moment leaves first.
    moves = sorted([(time, 1) for time in times] + [(time + TEN_MINUTES, 0) for time in times])
    for time, comes in moves:
        if time > end:
            break
        if comes:
            window.append(time)
            count += 1
            if start is None and len(window) > FLOOD_BEGIN_COUNT:
                start, count = time, len(window)
            continue
        window.popleft()
        if start is not None and len(window) < FLOOD_END_COUNT:
            floods.append(AlarmFlood(start=start, end=time, alarms=count))
            start = None
    if start is not None:
        floods.append(AlarmFlood(start=start, end=end, alarms=count))
    return floods


def _standing_ages(rows: Iterable[tuple[str, JournalRow]], end: float) -> dict[str, float]:
    """How long (s) each alarm that stands at the end has stood, the longest first."""
    since: dict[str, float] = {}
    for name, row in rows:
        if row.state not in ACTIVE:
            since.pop(name, None)
        else:
            # What is acknowledged has stood before; latched it stands on.
            since.setdefault(name, row.time)
    return dict(sorted(((name, end - begun) for name, begun in since.items()), key=lambda row: -row[1]))


def _verdict(average: float) -> str:
    if average <= ACCEPTABLE:
        return "very likely acceptable"
    if average <= MANAGEABLE:
        return "manageable"
    return "likely over-demanding" if average <= OVERLOADED else "very likely unacceptable"
