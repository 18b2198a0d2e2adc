"""Words by which a person chooses a method, apart from the methods: a command's options say them and load nothing."""

from typing import Literal

Search = Literal["tpe", "grid", "evolutionary"]
"""How settings are suggested: by the tree-structured Parzen estimator (Bergstra et al. 2011), from a grid in random
order, or by crossing and changing the best (NSGA-II, of one objective: Deb et al. 2002)."""
SEARCHES: tuple[Search, ...] = ("tpe", "grid", "evolutionary")
