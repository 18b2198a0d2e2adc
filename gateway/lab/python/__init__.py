"""The laboratory from Python: what its commands do, on data frames."""
