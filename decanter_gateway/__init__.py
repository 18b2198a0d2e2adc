"""The program's door: it looks whose packages are about to be imported, then calls the command line.

From Python it is the laboratory's door, `import decanter_gateway as decanter`: what the commands do, on data frames.
"""

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gateway.lab.python.frames import (
        DiagnosedGap,
        Judgement,
        LearnedModel,
        Recording,
        check,
        diagnose,
        forecast,
        judge,
        learn,
        read,
        simulate,
    )
else:
    NAMES = (
        "DiagnosedGap",
        "Judgement",
        "LearnedModel",
        "Recording",
        "check",
        "diagnose",
        "forecast",
        "judge",
        "learn",
        "read",
        "simulate",
    )

    def __dir__() -> list[str]:
        return sorted({*globals(), *NAMES})

    def __getattr__(name: str) -> Any:
        """One of NAMES. Raises ImportError where its packages are somebody else's."""
        from decanter_gateway.start import stranger

        if name not in NAMES:
            raise AttributeError(f"module 'decanter_gateway' has no attribute {name!r}")
        if (reason := stranger(Path(__file__).parents[1])) is not None:
            raise ImportError(reason)
        return getattr(import_module("gateway.lab.python.frames"), name)
