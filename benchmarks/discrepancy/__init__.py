"""A blind benchmark of `decanter diagnose`: hidden effects, sealed labels, rivals on the same cases, a table."""
