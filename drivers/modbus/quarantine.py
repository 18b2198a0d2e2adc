"""What a Modbus device refuses at present: what waits for how long, what is tried next, what rejoins."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from drivers.modbus.address import Area, TagSpan
from drivers.modbus.plan import (
    AddressBlock,
    Quarantine,
    RefusedRange,
    find_refusal,
    remove_refusal,
    retry_delay,
    with_refusal,
)
from drivers.tag import Quality

SILENCE_CAP_FACTOR = 6.0
"""What a device refuses by silence waits so many times as long at most."""


class RefusedAddresses:
    """The quarantine of one device.

    A refused place is asked again, alone, after `first` seconds, then after twice as long, up to `cap`; at most one
    such trial a reading, so that the neighbours' cycle stays short. A seam is tried by planning across it after `cap`.
    A block of which no part answers is the device's trouble and not an address's: nothing is quarantined, the block is
    asked as a whole each time, and cut again only after the same waiting times. `now` is monotonic, in seconds.
    """

    def __init__(self, first: float, cap: float) -> None:
        self._first = first
        self._cap = cap
        self._connects = 0
        self._hopeless: dict[tuple[Area, int, int], RefusedRange] = {}
        self.quarantine: Quarantine = ()

    @property
    def ranges(self) -> int:
        """How many places are refused at present."""
        return sum(not refusal.is_seam for refusal in self.quarantine)

    def renew(self, now: float, connects: int) -> None:
        """Let seams go whose time is over; after a new connection everything may be tried at once."""
        if connects != self._connects:
            self._connects = connects
            self._hopeless.clear()
            if self.quarantine:
                self.quarantine = tuple(replace(refusal, retry_at=now) for refusal in self.quarantine)
        if any(refusal.is_seam and refusal.retry_at <= now for refusal in self.quarantine):
            kept = (refusal for refusal in self.quarantine if not (refusal.is_seam and refusal.retry_at <= now))
            self.quarantine = tuple(kept)

    def trial(self, spans: Sequence[TagSpan], now: float) -> AddressBlock | None:
        """The refused place among these tags that has waited longest and may be asked again, if any."""
        due = [refusal for refusal in self.quarantine if not refusal.is_seam and refusal.retry_at <= now]
        for refusal in sorted(due, key=lambda refusal: refusal.retry_at):
            barred = [span for span in spans if find_refusal(span, (refusal,)) is not None]
            if barred:
                # The narrowest tag: a wider one may be refused for a neighbour's address and not for its own.
                least = min(barred, key=lambda span: span.count)
                same = tuple(span for span in barred if (span.start, span.count) == (least.start, least.count))
                return AddressBlock(least.area, least.start, least.count, same)
        return None

    def verdict(self, span: TagSpan, now: float) -> tuple[Quality, str]:
        """Quality and reason of a tag that was not asked because its place is refused."""
        refusal = find_refusal(span, self.quarantine)
        if refusal is None:
            return Quality.NO_DATA, "its place has just rejoined and is read next time"
        wait = max(0.0, refusal.retry_at - now)
        return Quality.CONFIGURATION_ERROR, f"{refusal.reason} (in quarantine, asked again in {wait:.1f} s)"

    def may_bisect(self, block: AddressBlock, now: float) -> bool:
        """False while a block of which no part answered waits."""
        hopeless = self._hopeless.get((block.area, block.start, block.count))
        return hopeless is None or hopeless.retry_at <= now

    def note_answer(self, block: AddressBlock) -> None:
        """The block as a whole answers (again)."""
        self._hopeless.pop((block.area, block.start, block.count), None)

    def found(
        self,
        block: AddressBlock,
        refusals: Sequence[RefusedRange],
        *,
        answered: bool,
        reasons: Mapping[tuple[int, int], str],
        now: float,
        silent: bool = False,
    ) -> None:
        """Take over what a bisection found: `note_answer` if any part did, `reasons` by (start, stop) of what did not.

        What was `silent` waits longer: asking it takes a deadline each time, and on a line more.
        """
        cap = self._cap * (SILENCE_CAP_FACTOR if silent else 1.0)
        key = (block.area, block.start, block.count)
        if not answered:
            before = self._hopeless.get(key)
            strikes = before.strikes + 1 if before else 1
            wait = retry_delay(strikes, self._first, self._cap)
            self._hopeless[key] = RefusedRange(block.area, block.start, block.stop, now + wait, strikes)
            return
        for refusal in refusals:
            wait = cap if refusal.is_seam else self._first
            reason = reasons.get((refusal.start, refusal.stop), "")
            self.quarantine = with_refusal(self.quarantine, replace(refusal, retry_at=now + wait, reason=reason))

    def rejoin(self, trial: AddressBlock) -> None:
        """A trial has answered: its place is planned with its neighbours again."""
        for refusal in self._inner_refusals(trial):
            self.quarantine = remove_refusal(self.quarantine, refusal)

    def again(self, trial: AddressBlock, reason: str, now: float, *, silent: bool = False) -> None:
        """A trial was refused: it waits twice as long."""
        cap = self._cap * (SILENCE_CAP_FACTOR if silent else 1.0)
        for refusal in self._inner_refusals(trial):
            strikes = refusal.strikes + 1
            wait = retry_delay(strikes, self._first, cap)
            again = replace(refusal, retry_at=now + wait, strikes=strikes, reason=reason)
            self.quarantine = with_refusal(self.quarantine, again)

    def _inner_refusals(self, trial: AddressBlock) -> Quarantine:
        refused = (refusal for refusal in self.quarantine if not refusal.is_seam and refusal.area is trial.area)
        return tuple(refusal for refusal in refused if trial.start <= refusal.start and refusal.stop <= trial.stop)
