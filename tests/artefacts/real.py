"""Where the learned automata of the public learner lie, when they are there."""

from pathlib import Path

import pytest

REAL = Path(__file__).parents[3] / "shared" / "data" / "lsha_upstream" / "artefacts"

real_data = [
    pytest.mark.real_data,
    pytest.mark.skipif(not REAL.is_dir(), reason=f"the learned automata are not at {REAL}"),
]

SETS = {
    "THERMO_UPPAAL_1": REAL,
    "THERMO_UPPAAL_2": REAL,
    "THERMO_UPPAAL_3": REAL,
    "THERMO_UPPAAL_4": REAL,
    "THERMO_UPPAAL_5": REAL,
    "HRI_SIM_3a": REAL / "hri_3a",
    "HRI_SIM_3b": REAL / "hri_3b",
    "ENERGY_MADE_1": REAL / "made",
}
