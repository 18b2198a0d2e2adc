"""The PLC's program behind all faces: its image, its cycle, its side of the contract, and the faults that strike it."""
