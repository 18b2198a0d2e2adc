"""Polynomials with exact rational coefficients: a number comes back as the very float that was written."""

from collections.abc import Mapping
from fractions import Fraction

Monomial = tuple[tuple[str, int], ...]
"""Variables with their powers, by name; () is the constant term."""

Polynomial = Mapping[Monomial, Fraction]
"""Coefficient of each monomial; none is zero, so that equal polynomials are equal mappings."""

ZERO: Polynomial = {}


def constant(value: Fraction) -> Polynomial:
    """The polynomial that is `value` everywhere."""
    return {(): value} if value else {}


def variable(name: str) -> Polynomial:
    """The polynomial that is the variable itself."""
    return {((name, 1),): Fraction(1)}


def add(left: Polynomial, right: Polynomial) -> Polynomial:
    """left + right."""
    total = dict(left)
    for monomial, value in right.items():
        total[monomial] = total.get(monomial, Fraction(0)) + value
    return {monomial: value for monomial, value in total.items() if value}


def multiply(left: Polynomial, right: Polynomial) -> Polynomial:
    """left * right."""
    total: dict[Monomial, Fraction] = {}
    for first, a in left.items():
        for second, b in right.items():
            powers = dict(first)
            for name, power in second:
                powers[name] = powers.get(name, 0) + power
            monomial = tuple(sorted(powers.items()))
            total[monomial] = total.get(monomial, Fraction(0)) + a * b
    return {monomial: value for monomial, value in total.items() if value}


def scale(factor: Fraction, polynomial: Polynomial) -> Polynomial:
    """factor * polynomial."""
    return {monomial: factor * value for monomial, value in polynomial.items() if factor}


def degree(polynomial: Polynomial) -> int:
    """The highest total degree among the terms; 0 for a constant."""
    return max((sum(power for _, power in monomial) for monomial in polynomial), default=0)


def term_text(monomial: Monomial) -> str:
    """The monomial as the flow file writes it: `1`, `P^2`, `P S`."""
    return " ".join(name if power == 1 else f"{name}^{power}" for name, power in monomial) or "1"
