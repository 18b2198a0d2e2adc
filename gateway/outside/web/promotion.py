"""A version of a model's store made the one that runs, on a person's word; it is proven first."""

from pathlib import Path

from drivers.errors import OneLineError
from gateway.outside.web.program import ProgramRefused, run_program

PATIENCE_S = 300.0


class PromotionRefused(OneLineError):
    """A version that is not made current; the message is one sentence."""


async def promote_version(store: Path, version: str) -> None:
    """Have a version of the store made current, if its model verifies. Raises PromotionRefused."""
    try:
        await run_program("model", "version", "promote", str(store), version, patience=PATIENCE_S)
    except TimeoutError:
        raise PromotionRefused(f"{version} was not proven within {PATIENCE_S:g} s; promote it at the box") from None
    except ProgramRefused as error:
        raise PromotionRefused(str(error) or f"{version} was not promoted") from None
