"""The table of rivals."""

from sim.lab.rivals.direct import Direct, arx, boosted_trees
from sim.lab.rivals.past import Rival
from sim.lab.rivals.persistence import Persistence
from sim.lab.rivals.univariate import Univariate


def rivals(seed: int) -> tuple[Rival, ...]:
    """Every rival, the simplest first; `seed` is for those that draw numbers. Univariate ones need the extra."""
    return (
        Persistence("persistence"),
        Univariate("damped trend", "damped_trend"),
        Univariate("AutoETS", "auto_ets"),
        Univariate("AutoARIMA", "auto_arima"),
        Univariate("AutoTheta", "auto_theta"),
        Direct("ARX, direct", arx, seed),
        Direct("boosted trees", boosted_trees, seed),
    )
