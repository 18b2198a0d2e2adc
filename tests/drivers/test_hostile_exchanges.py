"""No byte of a reading comes from a reply to another request, whatever habits the peer has (in virtual time)."""

import pytest

from benchmarks.hostile_exchanges import LINKS, habits_of, suffer
from drivers.modbus.replies import ReplyStream, TransactionIds
from drivers.modbus.serial_line import LineWire
from drivers.modbus.verify import split_frames

EXCHANGES = 2000


@pytest.mark.parametrize("link", LINKS)
def test_no_reading_is_wrong_and_good_over_any_link(link: str) -> None:
    tally = suffer(link, EXCHANGES, seed=7)
    assert tally.examples == []
    assert (tally.wrong, tally.escapes) == (0, 0)
    assert tally.exchanges >= EXCHANGES
    assert tally.good > EXCHANGES / 10
    assert set(tally.habits) == set(habits_of(link))


def is_seen(link: str) -> bool:
    """Whether a fault that was put in shows: it takes habits that come together by chance, here in two of three."""
    return any(suffer(link, 3000, seed=seed).wrong > 0 for seed in range(7, 19))


def test_the_judge_sees_ids_that_begin_at_one_with_each_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = ReplyStream.__init__

    def begin_anew(self: ReplyStream, ids: TransactionIds, *others: object) -> None:
        ids._last = 0
        ids._unanswered.clear()
        plain(self, ids, *others)  # type: ignore[arg-type]

    monkeypatch.setattr(ReplyStream, "__init__", begin_anew)
    assert is_seen("tcp")


def test_the_judge_sees_a_reply_that_was_cut_short_and_made_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    def take(self: ReplyStream, data: bytes, _expected: object) -> None:
        frames, self._rest = split_frames(self._rest + data)
        for frame in frames:
            self._give(frame)

    monkeypatch.setattr(ReplyStream, "take", take)
    monkeypatch.setattr(ReplyStream, "remainder", b"")
    assert is_seen("tcp")


def test_the_judge_sees_a_late_reply_on_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LineWire, "_find_owed_reply", lambda *_: None)
    assert is_seen("rtu-tcp")
