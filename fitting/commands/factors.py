"""jaxrelight-fit factors: a measured BRDF into separable factors."""

import dataclasses
import pathlib
import time
from typing import Annotated, ClassVar, Literal

import tyro

from jaxrelight.timing import timed

# Beyond it a fit of lobes is called poor, too.
_POOR = 0.25


@dataclasses.dataclass(frozen=True)
class Factors:
    """Factor a measured BRDF into products of maps of the light's and of the eye's direction.

    A scene uses what is written as [material.NAME] with type = "fitted" and file = "FACTORS.npz".
    """

    keeps: ClassVar[bool] = False  # of a run that was stopped

    file: tyro.conf.Positional[pathlib.Path]
    """A MERL .binary, RGL .bsdf or Cornell .brdf file."""
    output: Annotated[pathlib.Path, tyro.conf.arg(aliases=["-o"], metavar="FACTORS.npz")]
    """The maps."""
    terms: int = 4
    """Products; the most where --error is given."""
    error: float | None = None
    """Take as few terms as leave no more than this share of any channel, 0 to 1."""
    form: Literal["svd", "symmetric", "nonnegative", "normalised"] = "svd"
    """The products of least error; reciprocal ones; ones that are nowhere negative; or a single such one."""
    parametrisation: Literal["disc", "polar"] = "disc"
    """Of the maps: equal projected solid angles (eq. 10), or angles around the normal and from it (eq. 11)."""
    resolution: int = 48
    """Side of the maps."""
    refine: bool = False
    """Lower the error between the maps' texels, too; for the form svd. Takes a minute or more."""
    report: Annotated[pathlib.Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder for pictures: curves and spheres of data and factors, and residuals by angle."""
    json: bool = False
    """Print one JSON object at the end."""

    def run(self) -> None:
        """Runs the command."""
        start, seconds = time.perf_counter(), {}
        from fitting.brdf_samples import Grid, sample
        from fitting.commands.values import known, percent
        from fitting.factors import refined
        from fitting.report import check_report, write_report
        from fitting.residual_by_angle import DEGREES, Residual
        from fitting.weights import weights
        from jaxrelight.brdf.factored import Factored
        from jaxrelight.brdf.factors import check_terms, factor
        from jaxrelight.brdf.files import load_brdf
        from jaxrelight.brdf.files.fitted import write_factors
        from jaxrelight.brdf.parametrisation import PARAMETRISATIONS
        from jaxrelight.brdf.separable import separable
        from jaxrelight.command_line import versions
        from jaxrelight.commands.summary import summarize
        from jaxrelight.errors import InputError
        from jaxrelight.files.whole_file import check_place
        from jaxrelight.progress import notes, progress

        check_place(self.output, [".npz"], "factors")
        if self.refine and self.form != "svd":
            raise InputError(f"--refine is for the form svd, not for {self.form}; leave one of them out")
        if self.resolution < 2:
            raise InputError(f"--resolution must be at least 2, not {self.resolution}")
        parametrisation = PARAMETRISATIONS[self.parametrisation]
        check_terms(self.terms, self.resolution, parametrisation)
        if self.report is not None:
            check_report(self.report)
        with timed(seconds, "load"):
            measured = load_brdf(self.file)
        notes([*measured.notes, *measured.energy_notes()])
        steps = 2 if self.refine else 1
        change = None
        with timed(seconds, "fit"), progress(self.json) as report:
            report("factors", 0, steps)
            factors = factor(
                measured.brdf,
                self.terms,
                self.resolution,
                form=self.form,
                parametrisation=parametrisation,
                error=self.error,
            )
            report("factors", 1, steps)
            if self.refine:
                assert isinstance(factors, Factored)
                change = refined(measured.brdf, factors)
                factors = change.factors
                report("factors", 2, steps)
        brdf = separable(factors)
        with timed(seconds, "write"):
            write_factors(self.output, brdf)
        # Turned about the normal, since the maps' texels are not alike all around.
        samples = sample(measured.brdf, Grid(rotations=5))
        residual = Residual(brdf, samples, weights("cosine", samples))
        if (missed := residual.over()) > _POOR:
            notes([f"the factors miss {percent(missed)} of the reflected light; ask for more --terms, or fit lobes"])
        summary = {
            "command": "factors",
            "data": str(self.file),
            "format": measured.kind,
            "output": str(self.output),
            "form": self.form,
            "parametrisation": self.parametrisation,
            "terms": brdf.light_maps.shape[0],
            "resolution": brdf.light_maps.shape[-1],
            "bytes": brdf.light_maps.nbytes + brdf.view_maps.nbytes,
            "residual": known(missed),
        }
        if change is not None:
            summary |= {"refined": {"before": change.before, "after": change.after}, "refining_steps": change.steps}
        if self.report is not None:
            with timed(seconds, "report"):
                pictures = {"data": measured.brdf, f"{summary['terms']} terms": brdf}
                by_angle = DEGREES, DEGREES, residual.by_both("difference", "half")
                summary["report"] = [str(file) for file in write_report(self.report, pictures, by_angle)]
        seconds["total"] = time.perf_counter() - start
        summarize({**summary, "versions": versions(), "seconds": seconds}, self.json)
