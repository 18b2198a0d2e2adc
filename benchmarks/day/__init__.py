"""A scripted day of a plant of three machines, sixty times as fast, and the judge of what came of it."""
