"""Where the classes of a forecast's error begin; apart from what computes them, as a command's options say them too."""

YELLOW, RED = 0.4, 0.5
"""Relative errors from which a class begins, as the method's thesis has them."""
