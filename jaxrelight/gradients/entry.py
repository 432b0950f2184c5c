"""What is promised of the derivatives of a public function, and an example that the promise is tested by."""

import dataclasses
from collections.abc import Callable
from typing import Any, Literal

# A rule of types that most functions have.
FOLLOWS = "results have the type of the arguments"

# What is right at a singular point, along a direction: the two-sided derivative of a function that is smooth there, the
# one-sided derivative towards or from where the direction points, no slope, or any finite number.
Slope = Literal["smooth", "ahead", "behind", "zero", "finite"]


@dataclasses.dataclass(frozen=True)
class Example:
    """A function of arrays or pytrees of them alone, and arguments for it, in the inside of its domain.

    Args:
        function: of the differentiable arguments, in the order of `Entry.differentiable_in`; all else it holds itself.
        arguments: of any floating type; tests give them the type that they need.
        transpose: of the arguments and of a cotangent of the result: what the code itself has for the gradient by the
            last argument, in which the function is linear.
        along: a direction in which nothing changes that is held fixed, where that is not so in all.
    """

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    transpose: Callable[..., Any] | None = None
    along: tuple[Any, ...] | None = None


@dataclasses.dataclass(frozen=True)
class Singular:
    """A point where the plain formula has no derivative or a wrong one, and what is right there.

    Args:
        where: in words.
        arguments: of the example's function, at the point.
        along: a direction, shaped as the arguments are.
        slope: what the derivative along the direction is.
    """

    where: str
    arguments: tuple[Any, ...]
    along: tuple[Any, ...]
    slope: Slope = "smooth"


@dataclasses.dataclass(frozen=True)
class Entry:
    """What is promised of the derivatives of a function, in forward and reverse mode.

    Args:
        names: full names of the functions or methods; those after the first are forms of it, or parts that its example
            goes through.
        differentiable_in: its arguments, in words.
        example: a function and arguments to test it by.
        orders: 1, or 2 where the function is smooth enough for second derivatives.
        fixed: what is held fixed: it has no derivative of its own.
        kinks: the value chosen at each kink.
        ends: of the domain: what lies there.
        dtypes: the rule of types.
        singular: points to test it at, made when asked for.
        nan: where a NaN in an argument does not come out as a NaN: why.
    """

    names: tuple[str, ...]
    differentiable_in: str
    example: Callable[[], Example]
    orders: Literal[1, 2] = 1
    fixed: str = ""
    kinks: str = ""
    ends: str = ""
    dtypes: str = FOLLOWS
    singular: Callable[[], tuple[Singular, ...]] = tuple
    nan: str = ""


@dataclasses.dataclass(frozen=True)
class Exempt:
    """Functions of arrays that have no derivative of their own.

    Args:
        names: their full names.
        why: in words.
    """

    names: tuple[str, ...]
    why: str


# Reasons that many have.
CONTRACT = "a contract: each kind of it has an entry of its own"
HOST = "host code: NumPy, of numbers that are known"
FILES = "host code: reads or writes files"
RAYS = "host code: traces rays; visibility and hits are held fixed"
CHOICE = "a choice or a check, of numbers that are known"
PRECOMPUTATION = "host code: precomputation, pass by pass; what it makes is differentiable as its own entries say"

Entries = tuple[Entry | Exempt, ...]


def named(module: str, names: str) -> tuple[str, ...]:
    """Full names of functions of one module, given with spaces between them."""
    return tuple(f"{module}.{name}" for name in names.split())
