"""What tests and benchmarks share: the pair of processes, and an oracle that owes nothing to the product."""
