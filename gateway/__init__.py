"""The gateway compares what the plant says with what it should do, and acts."""

DISTRIBUTION = "decanter-gateway"
"""Whose package of this name it is: `decanter` looks before it starts (decanter_gateway.start)."""
