"""What the C library does with memory that is freed: a gateway keeps it, since it soon wants as much again."""

import ctypes

_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
"""The parameters of mallopt(3), as glibc's malloc.h numbers them."""
KEPT_BYTES = 64 << 20
LARGEST_BYTES = 4 << 20
"""An array up to this size is taken from what is kept; a larger one is mapped and given back."""


def keep_freed_memory() -> None:
    """Have freed memory stay with the process, in one pool for all threads (glibc; else nothing is done).

    A forecast's arrays are freed one after another. Given back to the system each time, every page of the next array
    has to be made again, which was a third of a forecast's processor time.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError):  # another C library than glibc has no such call
        return
    for parameter, value in ((_ARENA_MAX, 1), (_MMAP_THRESHOLD, LARGEST_BYTES), (_TRIM_THRESHOLD, KEPT_BYTES)):
        mallopt(parameter, value)
