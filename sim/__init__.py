"""What the plant should do: the model, its laboratory, and a software PLC to try it on."""

DISTRIBUTION = "decanter-gateway"
"""Whose package of this name it is: `decanter` looks before it starts (decanter_gateway.start)."""
