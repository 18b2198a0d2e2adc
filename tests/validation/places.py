"""Where the project's column maps are, and where the real data is if it is there."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
MAPS = ROOT / "config" / "traces"
DATA = ROOT.parent / "shared" / "data"
