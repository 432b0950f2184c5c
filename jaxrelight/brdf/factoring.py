"""How one material of a scene becomes separable factors."""

import dataclasses
from typing import get_args

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored, Symmetric
from jaxrelight.brdf.factors import Form, check_terms, factor
from jaxrelight.brdf.parametrisation import PARAMETRISATIONS
from jaxrelight.errors import InputError
from jaxrelight.methods import check_choice

# Terms that an error alone may take.
MAX_TERMS = 64


@dataclasses.dataclass(frozen=True)
class Factoring:
    """What a material asks of its factors (Wang 2006 §3.3); see `brdf.factors.factor`.

    Attributes:
        terms: their number, or the most of them where `error` is given; None for as many as the method says, or
            `MAX_TERMS`, or all that the maps have, where an error is given.
        error: as few terms as leave no more than this share of any channel; None for `terms` of them.
        form: "svd", "symmetric", "nonnegative" or "normalised".
        parametrisation: of their maps, "disc" (eq. 10) or "polar" (eq. 11).

    Raises:
        InputError: for what is not one of these.
    """

    terms: int | None = None
    error: float | None = None
    form: Form = "svd"
    parametrisation: str = "disc"

    def __post_init__(self) -> None:
        if self.terms is not None and self.terms < 1:
            raise InputError(f"'terms' must be at least 1, not {self.terms}")
        if self.form == "normalised" and self.terms not in (None, 1):
            raise InputError(f"the form 'normalised' has a single term, not {self.terms}; remove 'terms'")
        if self.error is not None and not 0 < self.error < 1:
            raise InputError(f"'terms_error' must lie between 0 and 1, not {self.error}")
        check_choice("'form'", self.form, get_args(Form))
        check_choice("'parametrisation'", self.parametrisation, tuple(PARAMETRISATIONS))

    def most_terms(self, otherwise: int, resolution: int) -> int:
        """The number of terms, or the most of them.

        Args:
            otherwise: as many as the method says.
            resolution: side of the maps.
        """
        if self.terms is not None:
            return self.terms
        if self.form == "normalised":
            return 1
        directions = int(PARAMETRISATIONS[self.parametrisation].directions(resolution)[1].sum())
        return otherwise if self.error is None else min(MAX_TERMS, directions)

    def check(self, otherwise: int, resolution: int) -> None:
        """Finds out, before long work, whether maps have enough directions.

        Args:
            otherwise: terms, as the method says.
            resolution: side of the maps.

        Raises:
            InputError: if they have not.
        """
        check_terms(self.most_terms(otherwise, resolution), resolution, PARAMETRISATIONS[self.parametrisation])

    @property
    def is_shared(self) -> bool:
        """Whether factors that all texels of a map share can be made so: singular values over the disc."""
        return self.error is None and self.form == "svd" and self.parametrisation == "disc"

    def factors(self, brdf: Brdf, otherwise: int, resolution: int) -> Factored:
        """The factors of a BRDF; the signs of symmetric ones go to the view maps.

        Args:
            brdf: what to factor.
            otherwise: terms, as the method says.
            resolution: side of the maps.

        Raises:
            InputError: as `factor` does.
        """
        terms, parametrisation = self.most_terms(otherwise, resolution), PARAMETRISATIONS[self.parametrisation]
        made = factor(brdf, terms, resolution, form=self.form, parametrisation=parametrisation, error=self.error)
        return made.as_factored() if isinstance(made, Symmetric) else made
