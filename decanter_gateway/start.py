"""The start of `decanter`: nothing of the program is imported before it is known that it is this program's."""

import os
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

FLOORS = ("drivers", "sim", "gateway")
"""The packages that this distribution installs beside this one; others may have packages of these names too."""
DISTRIBUTION = "decanter-gateway"


def main() -> None:
    """Run the command line; where a package of somebody else would be imported, one sentence and exit code 2."""
    reason = stranger(Path(__file__).parents[1])
    if reason is not None:
        print(f"decanter: {reason}", file=sys.stderr)  # noqa: T201 (nothing else may be imported yet)
        sys.exit(2)
    # The processes that this one starts do not look into the working folder either, whatever a person calls folders.
    os.environ["PYTHONSAFEPATH"] = "1"
    # Looking through all installed packages for plug-ins of pydantic costs each call, and none has a part in this.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    import_module("gateway.cli.main").main()


def stranger(home: Path) -> str | None:
    """The sentence about the first package that is not from `home`, or that another distribution has overwritten."""
    for name in FLOORS:
        spec = find_spec(name)
        if spec is None:
            return f"its package {name!r} is missing in {home}; install {DISTRIBUTION} anew"
        # Without an __init__ a folder is a package too, with places and no file of its own.
        place = Path(spec.origin).parent if spec.origin else Path(next(iter(spec.submodule_search_locations or [""])))
        if place.resolve() != (home / name).resolve():
            return (
                f"{name!r} would be imported from {place}, and its own package is {home / name}; take {place.parent} "
                f"off PYTHONPATH and sys.path, or install {DISTRIBUTION} into an environment of its own"
            )
        if getattr(import_module(name), "DISTRIBUTION", None) != DISTRIBUTION:
            return (
                f"{place} is another distribution's package of the same name; install {DISTRIBUTION} into an "
                f"environment of its own"
            )
    return None
