"""Runs a program under the system calls that a unit file allows, as systemd would: `-m ... UNIT PROGRAM ARGUMENTS`.

The sets are those that systemd itself names (`systemd-analyze syscall-filter`), the filter is made by libseccomp; what
is not allowed is refused with EPERM, as the unit says (systemd.exec(5): SystemCallFilter=, RestrictAddressFamilies=,
and MemoryDenyWriteExecute=, which is kept here whether the unit has it or not).
"""

import ctypes
import errno
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
LIBRARY = "libseccomp.so.2"
ALLOW, REFUSE = 0x7FFF0000, 0x00050000 | errno.EPERM
"""SCMP_ACT_ALLOW and SCMP_ACT_ERRNO(EPERM) of libseccomp's seccomp.h."""
MASKED_EQUAL = 7
"""SCMP_CMP_MASKED_EQ: an argument's bits under a mask are these."""
WRITE, EXECUTE, PROTECTION = 2, 4, 2
"""PROT_WRITE and PROT_EXEC of mman.h, and which argument of mmap, mprotect and pkey_mprotect has them."""
NO_NEW_PRIVILEGES = 38
"""PR_SET_NO_NEW_PRIVS of prctl(2), without which a filter takes a privilege to set."""


class Comparison(ctypes.Structure):
    """struct scmp_arg_cmp of libseccomp."""

    _fields_ = (
        ("argument", ctypes.c_uint),
        ("operator", ctypes.c_int),
        ("mask", ctypes.c_uint64),
        ("value", ctypes.c_uint64),
    )


Bound = tuple[int, int, tuple[int, ...]]
"""Which argument of a call is bounded, the mask over it, and the values under the mask that are allowed."""
UNBOUNDED: Bound = (0, 0, (0,))
PROTECTIONS: dict[str, Bound] = {
    "mmap": (PROTECTION, WRITE | EXECUTE, (0, WRITE, EXECUTE)),
    "mprotect": (PROTECTION, EXECUTE, (0,)),
    "pkey_mprotect": (PROTECTION, EXECUTE, (0,)),
}


def missing(unit: Path) -> str:
    """What this computer lacks to run something under the unit's filter; "" if nothing."""
    if shutil.which("systemd-analyze") is None:
        return "systemd-analyze is not installed"
    try:
        ctypes.CDLL(LIBRARY)
    except OSError:
        return f"{LIBRARY} is not installed"
    tried = subprocess.run([*runner(unit), "true"], capture_output=True, text=True, check=False, cwd=ROOT)
    return tried.stderr.strip().rpartition("\n")[2]


def runner(unit: Path) -> tuple[str, ...]:
    """What stands before a command that is to run under the unit's filter, from the project's folder."""
    return (sys.executable, "-m", "tests.rig.service_filter", str(unit))


def allowed_calls(unit: Path) -> set[str]:
    """The names of the calls that its lines SystemCallFilter= leave, in their order; @default is always allowed."""
    allowed = _members("@default")
    for line in unit.read_text(encoding="utf-8").splitlines():
        key, _, value = line.partition("=")
        if key == "SystemCallFilter":
            named = {call for name in value.lstrip("~").split() for call in _members(name)}
            allowed = allowed - named if value.startswith("~") else allowed | named
    return allowed


def _members(name: str) -> set[str]:
    if not name.startswith("@"):
        return {name}
    command = ["systemd-analyze", "syscall-filter", name]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    lines = [line.strip() for line in said.splitlines()[1:]]
    return {call for line in lines if line and not line.startswith("#") for call in _members(line)}


def allowed_families(unit: Path) -> tuple[int, ...]:
    """The numbers of the address families of its line RestrictAddressFamilies."""
    lines = unit.read_text(encoding="utf-8").splitlines()
    (named,) = (line.partition("=")[2] for line in lines if line.startswith("RestrictAddressFamilies="))
    return tuple(int(getattr(socket, name)) for name in named.split())


def restrict(calls: set[str], families: tuple[int, ...]) -> None:
    """Leave this process and its children these alone. Raises OSError where the kernel takes no filter."""
    library = ctypes.CDLL(LIBRARY)
    library.seccomp_init.restype = ctypes.c_void_p
    add = library.seccomp_rule_add_array
    add.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_int, ctypes.c_uint, ctypes.POINTER(Comparison)]
    library.seccomp_load.argtypes = [ctypes.c_void_p]
    context = library.seccomp_init(REFUSE)
    bounds: dict[str, Bound] = {**PROTECTIONS, "socket": (0, 0xFFFFFFFF, families)}
    for call in sorted(calls):
        number = library.seccomp_syscall_resolve_name(call.encode())
        argument, mask, values = bounds.get(call, UNBOUNDED)
        for value in values if number >= 0 else ():  # calls of other architectures have no number
            compared = Comparison(argument, MASKED_EQUAL, mask, value)
            if (code := add(context, ALLOW, number, 1 if mask else 0, ctypes.byref(compared))) != 0:
                raise OSError(-code, os.strerror(-code), call)
    ctypes.CDLL(None).prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    if (code := library.seccomp_load(context)) != 0:
        raise OSError(-code, os.strerror(-code))


if __name__ == "__main__":
    unit, *command = sys.argv[1:]
    restrict(allowed_calls(Path(unit)), allowed_families(Path(unit)))
    os.execvp(command[0], command)  # noqa: S606 - what it is given to run
