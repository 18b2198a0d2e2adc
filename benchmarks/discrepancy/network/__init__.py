"""A second plant for the benchmark of `decanter diagnose`: a lumped thermal network, sampled as recorders sample."""
