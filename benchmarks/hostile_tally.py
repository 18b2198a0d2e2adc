"""What is counted of hostile exchanges, whatever the link."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field


@dataclass
class Tally:
    """What became of the exchanges of a link: requests on the wire, or frames and messages where nobody asks."""

    exchanges: int = 0
    good: int = 0
    wrong: int = 0
    escapes: int = 0
    habits: Counter[str] = field(default_factory=Counter)
    good_by_habit: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)

    def escaped(self, error: object) -> None:
        """An exception where none may be."""
        self.escapes += 1
        self.examples.append(f"escaped: {error!r}")

    def note(self, habit: str) -> None:
        """Count a habit that was drawn; "" is none."""
        if habit:
            self.habits[habit] += 1

    def judge(self, what: str, habits: Iterable[str], *, good: bool) -> None:
        """A reading that is GOOD, of a reply with these habits: whether it is what it says."""
        self.good += 1
        self.good_by_habit.update(habits)
        if not good:
            self.wrong += 1
            self.examples.append(f"wrong: {what}")
