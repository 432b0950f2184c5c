"""One material as Lafortune lobes, with an account of how far they can be trusted."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fitting.albedo_error import albedo_error
from fitting.brdf_samples import BrdfSamples, Grid, sample
from fitting.residual_by_angle import Residual
from fitting.solve import Options, Verdict, fit_lobes
from fitting.weights import weights
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

# A fit whose albedo is further from the data's than this share of it is not good.
ALBEDO_TOLERANCE = 0.15


@dataclasses.dataclass(frozen=True)
class LafortuneFit:
    """A fit, and its account.

    Attributes:
        brdf: what the renderer takes.
        residual: root mean square of fit − samples over that of the samples, weighted.
        held_out: the same over samples that took no part in a fit to the others; NaN if none were held out.
        by_angle: the residual of samples whose angle lies between two of `residual_by_angle.DEGREES`, for the angles
            of incidence ("incident"), of the half vector ("half") and of the light to it ("difference"); NaN where
            there are none.
        by_difference_and_half: the same between two of them of the difference angle and two of the half angle.
        verdict: judged by residual and uncertainty, never by whether a solver stopped; and, of a fit that is good in
            these, by the light that it reflects and by what was held out.
        albedo_error: the largest relative difference of directional albedos of the fit and the data; see
            `albedo_error`.
        exponent_deviation: standard deviation of each log exponent, from the Jacobian; [l, c1].
        C_deviation: that of the direction of C, in radians; [l, c1].
        used: number of samples with weight.
        masked: number of samples left out because they are not finite.
        below: number of samples left out because a direction is below the surface.
    """

    brdf: LobeSum
    residual: float
    held_out: float
    by_angle: dict[str, Float[np.ndarray, " b"]]
    by_difference_and_half: Float[np.ndarray, "b b"]
    verdict: Verdict
    exponent_deviation: Float[np.ndarray, "l c1"]
    C_deviation: Float[np.ndarray, "l c1"]
    used: int
    masked: int
    below: int
    albedo_error: float

    @property
    def notes(self) -> tuple[str, ...]:
        """A line for every reason that samples were left out for."""
        lines = []
        if self.below:
            lines.append(
                f"{self.below:,} samples have a direction below the surface and were left out; the normal is z, not y"
            )
        if self.masked:
            lines.append(f"{self.masked:,} samples are not finite and were left out")
        return tuple(lines)


def fit_lafortune(
    material: Brdf | BrdfSamples,
    options: Options = Options(),
    weight: str = "log-cosine",
    hold_out: float = 0.1,
    grid: Grid | None = None,
) -> LafortuneFit:
    """Fits lobes to a BRDF or to samples of one (Lafortune 1997 §3).

    Args:
        material: a BRDF is sampled over `grid`.
        options: number and kind of lobes, and how they are sought.
        weight: a name that `weights` knows.
        hold_out: share of the samples, chosen evenly, that a second fit does without and is judged by; 0 for none.
        grid: where to sample; by default `Grid()`, with 12 rotations for anisotropic lobes.

    Raises:
        InputError: for an unknown weight, a share outside 0 … 0.5, or a grid given for samples.
    """
    if not 0 <= hold_out <= 0.5:
        raise InputError(f"hold_out must be from 0 to 0.5, not {hold_out}")
    if isinstance(material, BrdfSamples):
        if grid is not None:
            raise InputError("a grid is for a BRDF; samples have their own directions")
        samples = material
    else:
        samples = sample(material, grid or Grid(rotations=12 if options.anisotropic else 1))
    weight_of = weights(weight, samples)
    held = _chosen(len(samples.values), hold_out)
    fits = fit_lobes(
        samples.omega_i,
        samples.omega_o,
        as_array(np.broadcast_to(samples.values, (2, *samples.values.shape)), jnp.float32),
        np.stack([weight_of, np.where(held, 0, weight_of)]),
        options=options,
    )
    brdf, without = (jax.tree.map(lambda leaf, i=i: leaf[i], fits.brdf) for i in (0, 1))
    # What is below the surface takes part in no figure.
    compared = np.where(samples.is_above(), weight_of, 0)
    above = samples.is_above() & samples.is_finite()
    residual = Residual(brdf, samples, compared)
    held_out = Residual(without, samples, compared).over(held)
    energy = albedo_error(brdf, material)
    verdict = Verdict(int(fits.verdict[0]))
    if verdict == Verdict.GOOD and energy > ALBEDO_TOLERANCE:
        verdict = Verdict.ENERGY
    elif verdict == Verdict.GOOD and held_out > options.poor:
        verdict = Verdict.HELD_OUT
    return LafortuneFit(
        brdf=brdf,
        residual=float(fits.residual[0]),
        held_out=held_out,
        by_angle={name: residual.by(name) for name in samples.angles()},
        by_difference_and_half=residual.by_both("difference", "half"),
        verdict=verdict,
        exponent_deviation=np.asarray(fits.exponent_deviation[0]),
        C_deviation=np.asarray(fits.C_deviation[0]),
        used=int(fits.used[0]),
        masked=int(samples.is_above().sum() - above.sum()),
        below=int((~samples.is_above()).sum()),
        albedo_error=energy,
    )


def _chosen(count: int, share: float) -> np.ndarray:
    """Marks a share of the indices, spread as multiples of the golden ratio are: in step with no grid."""
    return np.arange(count) * ((5**0.5 - 1) / 2) % 1 < share
