"""Emergency messages (EMCY, CiA 301, 7.2.7): the errors that a node has announced and not taken back."""

from dataclasses import dataclass, field

from drivers.tag import Quality

MAX_ACTIVE_ERRORS = 32
"""Errors kept at a time; a node that announces more is in no better state for it."""
CLASSES: tuple[tuple[int, int, str, Quality], ...] = (
    (0x1000, 0xFF00, "generic error", Quality.UNCERTAIN),
    (0x2000, 0xF000, "current", Quality.UNCERTAIN),
    (0x3000, 0xF000, "voltage", Quality.UNCERTAIN),
    (0x4000, 0xF000, "temperature", Quality.UNCERTAIN),
    (0x5000, 0xFF00, "device hardware", Quality.DEVICE_FAILURE),
    (0x6000, 0xF000, "device software", Quality.DEVICE_FAILURE),
    (0x7000, 0xFF00, "additional modules", Quality.UNCERTAIN),
    (0x8000, 0xF000, "monitoring", Quality.UNCERTAIN),
    (0x9000, 0xFF00, "external error", Quality.UNCERTAIN),
    (0xF000, 0xFF00, "additional functions", Quality.UNCERTAIN),
    (0xFF00, 0xFF00, "device specific", Quality.UNCERTAIN),
)
"""Error code under a mask, what CiA 301 calls it, and the best quality that a reading has meanwhile."""


def describe(code: int) -> str:
    """`EMCY 0x5000 (device hardware)`."""
    return f"EMCY 0x{code:04X} ({_class(code)[0]})"


def _class(code: int) -> tuple[str, Quality]:
    for pattern, mask, words, quality in CLASSES:
        if code & mask == pattern:
            return words, quality
    return "no class of CiA 301", Quality.UNCERTAIN


@dataclass(slots=True)
class Emergencies:
    """The errors that stand, by code, with the error register that came with each. `ignored` ones are only told."""

    ignored: frozenset[int] = frozenset()
    active: dict[int, int] = field(default_factory=dict)
    heard: int = 0
    malformed: int = 0

    def take(self, data: bytes) -> None:
        """An emergency message. Code 0x00xx takes all errors back."""
        if len(data) != 8:
            self.malformed += 1
            return
        self.heard += 1
        self.stands(int.from_bytes(data[:2], "little"), data[2])

    def stands(self, code: int, register: int) -> None:
        """The node has this error."""
        if code & 0xFF00 == 0:
            self.active.clear()
        elif code in self.active or len(self.active) < MAX_ACTIVE_ERRORS:
            self.active[code] = register

    def verdict(self) -> tuple[Quality, str] | None:
        """The quality that readings have at best, and the reason; None while no error stands that matters."""
        mattering = [(_class(code)[1], code) for code in self.active if code not in self.ignored]
        if not mattering:
            return None
        quality, code = max(mattering)
        return quality, f"the node has announced {describe(code)}"

    def sentences(self) -> tuple[str, ...]:
        """Every error that stands, in words."""
        return tuple(f"{describe(code)}, error register 0x{register:02X}" for code, register in self.active.items())
