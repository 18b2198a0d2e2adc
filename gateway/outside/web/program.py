"""The program itself, called by the page for what takes long: in a process of its own, so that no scan waits for it."""

import asyncio
import os
import sys

from drivers.errors import OneLineError
from gateway.outside.web.reader_process import NICENESS

PROGRAM = "gateway.cli.main"


class ProgramRefused(OneLineError):
    """What was asked for is not done; the message is one sentence ("": the program said none)."""


async def run_program(*arguments: str, patience: float) -> str:
    """What the program prints. Raises ProgramRefused where it ends with an error, TimeoutError after `patience` (s)."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", PROGRAM, *arguments),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
    )
    try:
        os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        async with asyncio.timeout(patience):
            printed, said = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
    if process.returncode:
        raise ProgramRefused(" ".join(said.decode(errors="replace").split()).removeprefix("decanter: "))
    return printed.decode(errors="replace")
