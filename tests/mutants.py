"""`make mutants`: mutmut over the modules that pyproject.toml lists, the score of each module, and what survived."""

import json
import shutil
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parent.parent
MADE = ROOT / "mutants"
MUTMUT = [sys.executable, "-m", "mutmut"]
NO_TEST = 33
"""mutmut's code of a mutant that no test comes by."""
KILLED = {1, 3, 24, 36, 37, 152, 255, -24}
"""Its codes of a test that failed, of one that took far too long, and of a mutant that the types refuse."""


def judged(made: Path) -> Iterator[tuple[str, str, int]]:
    """(module, mutant, mutmut's code) of every mutant that was tried."""
    for file in sorted(made.rglob("*.py.meta")):
        module = str(file.relative_to(made)).removesuffix(".py.meta").replace("/", ".")
        codes = json.loads(file.read_text(encoding="utf-8"))["exit_code_by_key"]
        yield from ((module, name, code) for name, code in codes.items() if code is not None)


def report() -> None:
    """Print what survived, and the score of each module and of all."""
    codes: defaultdict[str, Counter[bool]] = defaultdict(Counter)
    for module, name, code in judged(MADE):
        codes[module][code in KILLED] += 1
        if code not in KILLED:
            shown = subprocess.run([*MUTMUT, "show", name], cwd=ROOT, capture_output=True, text=True, check=False)
            print(f"{name}: {'no test comes by' if code == NO_TEST else 'survived'}")
            print("\n".join(line for line in shown.stdout.splitlines() if line[:2] in ("- ", "+ ")))
    for module, count in [*codes.items(), ("all", sum(codes.values(), Counter[bool]()))]:
        print(f"{count[True]} of {count.total()} killed, {count[True] / max(count.total(), 1):.1%}: {module}")


def main(words: list[str]) -> int:
    # What was copied when other modules were listed is not mutated again.
    shutil.rmtree(MADE, ignore_errors=True)
    done = subprocess.run([*MUTMUT, "run", "--max-children", "1", *words], cwd=ROOT, check=False)
    report()
    return done.returncode


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
