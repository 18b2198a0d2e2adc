"""The table of rivals."""

from sim.rivals.direct import Direct, arx, boosted_trees
from sim.rivals.past import Rival
from sim.rivals.persistence import Persistence
from sim.rivals.univariate import Univariate


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
