"""`decanter reload`: a running gateway takes over what its plant file says now."""

from collections.abc import Iterator
from pathlib import Path

from gateway.console import CommandResult, Line, Part, conclude
from gateway.entry import Exit, fail, sentences
from gateway.outside.status import ControlError, connect
from gateway.settings import load_plant

PATIENCE_S = 60.0
"""A machine that is stopped for it takes back what stands in its PLC first."""


def reload(path: Path, dry_run: bool, socket: Path | None, as_json: bool) -> None:
    """The work of `reload`."""
    with sentences():
        # A file that cannot be used is refused here and now: nobody has to run for that.
        place = load_plant(path)[0].control_socket if socket is None else socket
        if (line := connect(place, PATIENCE_S)) is None:
            fail(
                f"no gateway runs with {path} (nothing answers at {place}); where historian.path or control.path were "
                "changed in the file, the gateway is still at its former socket (--socket), and only a restart takes "
                "over such a change: stop it and start it anew",
                Exit.CANNOT_CONNECT,
            )
        try:
            answer = line.ask("reload", dry_run=dry_run)
        except ControlError as error:
            fail(str(error), Exit.CHECK_FAILED)
        finally:
            line.close()
    changes: dict[str, list[str]] = answer["changes"]
    next_start: list[str] = answer["next_start"]

    def show() -> Iterator[Part]:
        for name, sentences_of in changes.items():
            for sentence in sentences_of:
                yield f"{name}: {sentence}"
        if not changes:
            yield "nothing has changed"
        else:
            yield "dry run: nothing was taken over" if dry_run else "taken over"
        for sentence in next_start:
            yield Line(sentence, "yellow")

    data = {"changes": changes, "applied": answer["applied"], "next_start": next_start}
    conclude(CommandResult(data), lambda _: show(), as_json=as_json)
