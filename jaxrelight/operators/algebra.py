"""Operators made of others; they are defined beside `Operator`, whose `+`, `@` and `*` make them."""

from jaxrelight.operators.contract import Composed, InBasis, Scaled, Summed, parts_of

__all__ = ["Composed", "InBasis", "Scaled", "Summed", "parts_of"]
