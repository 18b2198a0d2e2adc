"""A version of a model's store made the one that runs, on a person's word.

It is proven first, by the program itself in a process of its own: that takes the processor for seconds, and no scan
waits for the interpreter meanwhile.
"""

import asyncio
import os
import sys
from pathlib import Path

from gateway.web.reader_process import NICENESS

PROGRAM = "gateway.cli.main"
PATIENCE_S = 300.0


class PromotionRefused(Exception):
    """A version that is not made current; the message is one sentence."""


async def promote_version(store: Path, version: str) -> None:
    """Have a version of the store made current, if its model verifies. Raises PromotionRefused."""
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", PROGRAM, "model", "promote", str(store), version),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
        stderr=asyncio.subprocess.PIPE,
        start_new_session=True,
    )
    try:
        os.setpriority(os.PRIO_PROCESS, process.pid, NICENESS)
        async with asyncio.timeout(PATIENCE_S):
            _, said = await process.communicate()
    except TimeoutError:
        raise PromotionRefused(f"{version} was not proven within {PATIENCE_S:g} s; promote it at the box") from None
    finally:
        if process.returncode is None:
            process.kill()
    if process.returncode:
        sentence = " ".join(said.decode(errors="replace").split()).removeprefix("decanter: ")
        raise PromotionRefused(sentence or f"{version} was not promoted")
