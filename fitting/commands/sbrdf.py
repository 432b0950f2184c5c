"""jaxrelight-fit sbrdf: a stack of photographs into maps of lobes."""

import dataclasses
import pathlib
import shutil
import time
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jaxrelight.timing import timed

if TYPE_CHECKING:
    import numpy as np

    from fitting.sbrdf import SbrdfFit
    from fitting.stack import Stack


@dataclasses.dataclass(frozen=True)
class Sbrdf:
    """Fit a Lafortune BRDF to every texel of photographs of one surface under many lights.

    What is done stays done: run it again after a stop and it goes on.
    """

    stack: tyro.conf.Positional[pathlib.Path]
    """A .npz file of images and light directions, or a .toml file that lists them."""
    output: Annotated[pathlib.Path, tyro.conf.arg(aliases=["-o"], metavar="MAPS.exr")]
    """Maps of albedos, lobes, normals and residuals, a channel each."""
    lobes: Literal[1, 2, 3] = 1
    """How many for each texel, beside a diffuse part."""
    anisotropic: bool = False
    """Seek a direction of anisotropy for every texel."""
    hold_out: int = 8
    """Every so many images, one takes no part in the fit and is predicted by it; 0 fits to all."""
    levels: bool = False
    """Write coarser levels of detail too, each refitted to the mean BRDF of four texels."""
    storage: Literal["float", "half", "8bit"] = "float"
    """Bytes of a number in the file: four, two, or one; what rounding does to lobes is measured for each."""
    report: Annotated[pathlib.Path | None, tyro.conf.arg(metavar="FOLDER")] = None
    """Folder for pictures: a photograph beside what the fit has it as, and residuals by texel."""
    json: bool = False
    """Print one JSON object at the end."""

    def run(self) -> None:
        """Runs the command."""
        start, seconds = time.perf_counter(), {}
        import numpy as np

        from fitting.commands.values import known
        from fitting.prediction import lambert_only, predicted, relative_error
        from fitting.report import check_report
        from fitting.sbrdf import fit_sbrdf
        from fitting.sbrdf_levels import coarser
        from fitting.solve import Options
        from fitting.stack_files import load_stack
        from jaxrelight.brdf.files.sbrdf import write_sbrdf
        from jaxrelight.command_line import versions
        from jaxrelight.commands.summary import summarize
        from jaxrelight.errors import InputError
        from jaxrelight.files.whole_file import check_place
        from jaxrelight.progress import notes, progress

        check_place(self.output, [".exr"], "maps")
        if self.hold_out < 0 or self.hold_out == 1:
            raise InputError(f"--hold-out must be 0, or at least 2, not {self.hold_out}")
        if self.report is not None:
            check_report(self.report)
        options = Options(lobes=self.lobes, anisotropic=self.anisotropic)
        with timed(seconds, "load"):
            stack = load_stack(self.stack)
        notes(list(stack.notes))
        held = np.zeros(len(stack.images), bool)
        if self.hold_out:
            held[self.hold_out - 1 :: self.hold_out] = True
        fitted_to = stack.of(~held)
        # Parts lie beside the output, so that the same command finds them and another one does not.
        parts = self.output.with_name(f".{self.output.name}.parts")
        with timed(seconds, "fit"), progress(self.json) as report:
            fit = fit_sbrdf(fitted_to, options, folder=parts, report=lambda done, total: report("texels", done, total))
        levels, mask = [fit.level], fit.mask
        if self.levels:
            with timed(seconds, "levels"):
                while max(mask.shape) > 1:
                    level, mask = coarser(levels[-1], mask, options)
                    levels.append(level)
        with timed(seconds, "write"):
            write_sbrdf(self.output, levels, self.storage)
            shutil.rmtree(parts, ignore_errors=True)
        summary = {
            "command": "sbrdf",
            "data": str(self.stack),
            "output": str(self.output),
            "texels": int(fit.mask.sum()),
            "images": int((~held).sum()),
            "lobes": self.lobes,
            "storage": self.storage,
            "bytes": self.output.stat().st_size,
            "levels": [[level.lobes.shape[1], level.lobes.shape[0]] for level in levels],
            "estimated_normals": fit.estimated,
            "verdicts": fit.counts(),
            "residual": known(relative_error(predicted(fit.level, fitted_to), fitted_to)),
        }
        if held.any():
            unseen = stack.of(held)
            alone = lambert_only(fitted_to, fit.level.normals)
            summary["held_out_images"] = int(held.sum())
            summary["held_out"] = {
                "lambert": known(relative_error(predicted(alone, unseen), unseen)),
                "lobes": known(relative_error(predicted(fit.level, unseen), unseen)),
            }
        if self.report is not None:
            with timed(seconds, "report"):
                shown = stack.of(held if held.any() else np.arange(len(held)) == 0)
                summary["report"] = _pictures(self.report, fit, shown, predicted(fit.level, shown))
        seconds["total"] = time.perf_counter() - start
        summarize({**summary, "versions": versions(), "seconds": seconds}, self.json)


def _pictures(folder: pathlib.Path, fit: "SbrdfFit", shown: "Stack", images: "np.ndarray") -> list[str]:
    """The first of some images beside its prediction, and the residuals: the files."""
    import numpy as np

    from fitting.report import heat_map, side_by_side

    files = [folder / "images.png", folder / "residuals.png"]
    known, first = shown.usable[0] & fit.mask, shown.images[0]
    exposure = -np.log2(max(float(first[known].mean()) if known.any() else 0.0, 1e-12) / 0.25)
    # What was saturated is white.
    photograph = np.where(fit.mask[..., None], np.where(shown.usable[0][..., None], first, 2.0**-exposure), 0)
    side_by_side([photograph, images[0]], exposure, files[0])
    residuals = fit.level.residual[np.isfinite(fit.level.residual)]
    largest = max(float(np.percentile(residuals, 99)), 1e-6) if residuals.size else 1.0
    heat_map(fit.level.residual, fit.mask, largest, files[1])
    return [str(file) for file in files]
