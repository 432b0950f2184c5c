"""jaxrelight-fit lafortune: a measured BRDF into lobes."""

import dataclasses
import pathlib
import time
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from jaxrelight.timing import timed

if TYPE_CHECKING:
    from fitting.lafortune import LafortuneFit
    from jaxrelight.brdf.files import BrdfFile


@dataclasses.dataclass(frozen=True)
class Lafortune:
    """Fit Lafortune lobes to a measured BRDF.

    A scene uses what is written as [material.NAME] with type = "fitted" and file = "NAME.toml".
    """

    keeps: ClassVar[bool] = False  # of a run that was stopped

    file: tyro.conf.Positional[pathlib.Path]
    """A MERL .binary, RGL .bsdf or Cornell .brdf file."""
    output: Annotated[pathlib.Path, tyro.conf.arg(aliases=["-o"], metavar="NAME.toml")]
    """The lobes, as text, with an account of the fit."""
    lobes: Literal[1, 2, 3] = 2
    """How many, beside a diffuse part."""
    weight: Literal["plain", "cosine", "log-cosine"] = "log-cosine"
    """What is compared: reflectance; reflected light, where highlights outweigh all else; or that on a logarithmic
    scale, which pictures agree with best."""
    anisotropic: bool = False
    """Let lobes differ along and across the tangent."""
    per_channel: bool = False
    """Give each colour channel lobes of its own."""
    starts: int = 2
    """Places, 1 to 7, that each lobe is sought from; more find better lobes, and take longer."""
    hold_out: float = 0.1
    """Share of the samples that a second fit does without and is judged by."""
    report: Annotated[pathlib.Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder for pictures: curves and spheres of data and fit, and residuals by angle."""
    json: bool = False
    """Print one JSON object at the end."""

    def run(self) -> None:
        """Runs the command."""
        start, seconds = time.perf_counter(), {}
        from fitting.commands.values import known
        from fitting.lafortune import fit_lafortune
        from fitting.report import check_report, write_report
        from fitting.residual_by_angle import DEGREES
        from fitting.solve import Options
        from jaxrelight.brdf.files import load_brdf
        from jaxrelight.brdf.files.fitted import write_lobes
        from jaxrelight.command_line import versions
        from jaxrelight.commands.summary import summarize
        from jaxrelight.files.whole_file import check_place
        from jaxrelight.progress import notes, progress

        check_place(self.output, [".toml"], "lobes")
        if self.report is not None:
            check_report(self.report)
        options = Options(
            lobes=self.lobes, anisotropic=self.anisotropic, per_channel=self.per_channel, starts=self.starts
        )
        with timed(seconds, "load"):
            measured = load_brdf(self.file)
        notes([*measured.notes, *measured.energy_notes()])
        with timed(seconds, "fit"), progress(self.json) as report:
            report("fit", 0, 1)
            fit = fit_lafortune(measured.brdf, options, self.weight, self.hold_out)
            report("fit", 1, 1)
        notes(list(fit.notes))
        if (albedo := float(fit.brdf.normal_albedo.max())) > 1.01:
            notes([f"the fit reflects {albedo:.3g} times the light it gets along the normal; try --weight log-cosine"])
        with timed(seconds, "write"):
            write_lobes(self.output, fit.brdf, self._remarks(measured, fit))
        summary = {
            "command": "lafortune",
            "data": str(self.file),
            "format": measured.kind,
            "output": str(self.output),
            "lobes": self.lobes,
            "weight": self.weight,
            "exponents": known(fit.brdf.exponent),
            "exponent_deviation": known(fit.exponent_deviation),
            "C_deviation": known(fit.C_deviation),
            "residual": known(fit.residual),
            "held_out": known(fit.held_out),
            "by_angle": {name: known(values) for name, values in fit.by_angle.items()},
            "albedo_error": known(fit.albedo_error),
            "verdict": str(fit.verdict),
            "meaning": fit.verdict.message,
            "samples": fit.used,
            "masked": fit.masked,
            "below": fit.below,
        }
        if self.report is not None:
            with timed(seconds, "report"):
                pictures = {"data": measured.brdf, "fit": fit.brdf}
                files = write_report(self.report, pictures, (DEGREES, DEGREES, fit.by_difference_and_half))
            summary["report"] = [str(file) for file in files]
        seconds["total"] = time.perf_counter() - start
        summarize({**summary, "versions": versions(), "seconds": seconds}, self.json)

    def _remarks(self, measured: "BrdfFile", fit: "LafortuneFit") -> list[str]:
        """What the file says of itself."""
        from fitting.commands.values import percent

        remarks = [
            "diffuse/π + Σ peak · max(0, ω_oᵀ C ω_i / max|C|)^exponent in 1/sr, linear Rec.709",
            "",
            f"data      {self.file.name} ({measured.kind})",
            f"weight    {self.weight}",
            f"residual  {percent(fit.residual)} of the data",
            f"held out  {percent(fit.held_out)} of data that a fit to the rest did not see",
            f"albedo    off by {percent(fit.albedo_error)} where it is furthest from the data's",
            f"verdict   {fit.verdict}: {fit.verdict.message}",
        ]
        for number, deviation in enumerate(fit.exponent_deviation.max(axis=1), 1):
            remarks.append(f"lobe {number}    exponent known to {percent(deviation)}")
        return remarks
