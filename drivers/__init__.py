"""What the plant says: tags in, samples out."""

DISTRIBUTION = "decanter-gateway"
"""Whose package of this name it is: `decanter` looks before it starts (decanter_gateway.start)."""
