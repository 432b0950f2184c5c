"""jaxrelight inverse materials: materials of a known scene, from pictures of it."""

import dataclasses
import math
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import tyro

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.options import (
    Json,
    LightOptions,
    LinearLighting,
    Modules,
    ReportFolder,
    ScenePath,
    StoreFolder,
    Up,
    check_toml,
    import_modules,
    make_folder,
)
from jaxrelight.commands.summary import summary_of
from jaxrelight.errors import InputError
from jaxrelight.timing import timed

if TYPE_CHECKING:
    from jaxrelight.brdf.contract import Brdf
    from jaxrelight.brdf.lobes import LobeSum
    from jaxrelight.brdf.material import Material
    from jaxrelight.inverse.material_certainty import Estimate
    from jaxrelight.inverse.solve_materials import InverseMaterials
    from jaxrelight.scene.scene import Scene


@dataclasses.dataclass(frozen=True)
class InverseMaterialsCommand:
    """Solve a picture of a scene under known lights for its materials.

    The scene's own materials are what the search starts from: their colours, exponents and textures. Numbers that the
    picture does not tell are named.
    """

    scene: ScenePath
    picture: Annotated[tyro.conf.Positional[pathlib.Path], tyro.conf.arg(metavar="PICTURE")]
    """What the scene's camera sees, in linear radiance: an .exr or .hdr file."""
    unknown: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME[:PART,…]")]
    """A material that is sought, by its name; behind a colon, which of its parameters: albedo of a lambert, and
    diffuse, specular, exponent and C of others; by default all but C. May be given again."""
    output: Annotated[pathlib.Path | None, tyro.conf.arg(aliases=["-o"], metavar="FILE")] = None
    """A .toml file for the materials found, as [material.NAME] of a scene."""
    texture: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME:PART=ROWSxCOLUMNS")] = ()
    """A colour that is sought for every texel of a texture, as floor:albedo=64x64; written as .exr beside the
    materials. The scene's material has to be textured there. May be given again."""
    mask: pathlib.Path | None = None
    """A picture that is black where pixels do not count."""
    saturation: float | None = None
    """Radiance from which a channel of a pixel is left out."""
    light_scale: bool = False
    """Seek a factor on all lights, too, where the picture tells it apart from colours."""
    noise: float | None = None
    """Standard deviation of a pixel, relative to it; by default what is missed tells it, the same for all."""
    hold_out: float = 0.1
    """Share of the pixels that is not fitted, and tells the fit's error."""
    smoothness: float = 1e-4
    """Of textures, relative to what an average texel's pixels tell; 0 for none."""
    lighting: LinearLighting = "auto"
    """The lighting method, as for `render`."""
    light: tyro.conf.OmitArgPrefixes[LightOptions] = LightOptions()
    store: StoreFolder = None
    report: ReportFolder = None
    """A folder for the picture, what was found, and the difference, as .png and .exr."""
    up: Up = "y"
    modules: Modules = ()
    json: Json = False

    # What `with_dials` tells of the method that cannot do it.
    cannot: ClassVar[str] = "plans samples for one light; solve with another method"

    def run(self) -> None:
        """Runs the command."""
        with summary_of("inverse materials", self.json) as (summary, seconds):
            with timed(seconds, "imports"):
                from jaxrelight.commands.pictures import describe, prepared
                from jaxrelight.images import read_image
                from jaxrelight.inverse.solve_materials import materials
                from jaxrelight.progress import notes, progress
                from jaxrelight.scene.mesh_scene import open_scene

                import_modules(self.modules)
            with timed(seconds, "load"):
                scene = open_scene(self.scene, zero_nonfinite=self.light.zero_nonfinite, up=self.up)
                lights = self.light.lights(scene.lights, scene.emits)
                picture = read_image(self.picture)[..., :3]
                mask = None if self.mask is None else read_image(self.mask)[..., :3].max(axis=-1) > 0
                unknowns = self._unknowns(scene)
                height, width = picture.shape[:2]
                camera = dataclasses.replace(scene.camera, width=width, height=height)
                scene = dataclasses.replace(scene, camera=camera)
            check_toml(self.output, "materials")
            make_folder("--report", self.report)
            notes(dict.fromkeys((*scene.notes, *lights.notes)))
            with progress(self.json) as report:
                relighter = prepared(scene, method_of(self), self.store, report, summary, seconds)
                with timed(seconds, "solve"):
                    found = materials(
                        relighter,
                        [picture],
                        lights=lights,
                        unknowns=unknowns,
                        light_scale=self.light_scale,
                        masks=None if mask is None else [mask],
                        deviations=None if self.noise is None else [_deviation(picture, self.noise)],
                        saturation=self.saturation,
                        hold_out=self.hold_out,
                        smoothness=self.smoothness,
                    )
            notes(found.notes)
            if self.output is not None:
                write_materials(self.output, found)
                summary["output"] = str(self.output)
            if self.report is not None:
                with timed(seconds, "report"):
                    write_report(self.report, picture, found)
                summary["report"] = str(self.report)
            if self.json:
                summary["materials"] = told(found)
            else:
                print("\n".join(lines_of(found)), flush=True)
            summary |= {"residual": found.residual, "held_out": found.held_out, "pixels": found.pixels}
            summary |= {"saturated": found.saturated, "undetermined": list(found.undetermined)}
            summary |= {"light_scale": None if found.light_scale is None else float(found.light_scale.value)}
            summary |= {"held_fixed": list(found.held), "steps": found.steps, "converged": found.converged}
            summary |= describe(relighter)

    def _unknowns(self, scene: "Scene") -> dict[str, Any]:
        """What is sought, started from the scene's own materials."""
        from jaxrelight.brdf.material import Material, as_material
        from jaxrelight.inverse.material_unknowns import Unknown

        textures: dict[str, dict[str, tuple[int, int]]] = {}
        for given in self.texture:
            name, part, rows, columns = _texture_of(given)
            textures.setdefault(name, {})[part] = (rows, columns)
        unknowns = {}
        for given in self.unknown:
            name, _, parts = given.partition(":")
            if name not in scene.materials:
                raise InputError(
                    f"--unknown {given}: the scene has no material '{name}'; it has {', '.join(scene.materials)}"
                )
            own = textures.pop(name, {})
            start = scene.materials[name]
            if own and isinstance(start, Material):
                start = _untextured(as_material(start))
            unknowns[name] = Unknown(start, tuple(parts.split(",")) if parts else None, own)
        if textures:
            name = next(iter(textures))
            raise InputError(f"--texture {name}: is of a material that is sought; name it with --unknown {name}, too")
        return unknowns


def _texture_of(given: str) -> tuple[str, str, int, int]:
    """Name, parameter, rows and columns of --texture."""
    name, _, rest = given.partition(":")
    part, _, size = rest.partition("=")
    numbers = size.lower().split("x")
    if not (name and part and len(numbers) == 2 and all(number.isdigit() for number in numbers)):
        raise InputError(f"--texture {given}: write it as NAME:PART=ROWSxCOLUMNS, such as floor:albedo=64x64")
    return name, part, int(numbers[0]), int(numbers[1])


def _untextured(material: Any) -> "LobeSum":
    """The sum of lobes that a material of grey BRDFs times textures is in the mean: what texels are started from."""
    import numpy as np

    from jaxrelight.brdf.lobes import LobeSum, lambert, lobe_sum

    diffuse, lobes = np.zeros(3), []
    for component in material.components:
        brdf = component.brdf
        if not isinstance(brdf, LobeSum):
            raise InputError("textures are sought of materials that are sums of lobes")
        weight = np.prod([np.broadcast_to(one.mean, 3) for one in component.weight], axis=0) * np.ones(3)
        diffuse = diffuse + weight * np.asarray(brdf.diffuse)
        for C, n, scale in zip(*(np.asarray(of) for of in (brdf.C, brdf.exponent, brdf.scale)), strict=True):
            lobes.append((C, n, weight * scale))
    return lobe_sum(diffuse, lobes) if lobes else lambert(diffuse)


def _deviation(picture: Any, noise: float) -> Any:
    """Of pixels, and a thousandth of their mean at least."""
    import numpy as np

    if not noise > 0:
        raise InputError(f"--noise is {noise:g}; it must be above 0")
    return noise * np.maximum(picture, 1e-3 * max(float(picture.mean()), 1e-30))


def told(found: "InverseMaterials") -> dict[str, Any]:
    """Estimates for programs, by parameter; a number that is infinite is null, textures are left to files."""
    entries: dict[str, Any] = {}
    for key, one in found.estimates.items():
        if _is_texture(key, one):
            entries[key] = {"texels": list(one.value.shape[:2])}
            continue
        entries[key] = {
            name: [float(x) if math.isfinite(x) else None for x in getattr(one, name).ravel()]
            for name in ("value", "deviation", "low", "high")
        }
        entries[key]["determined"] = [bool(x) for x in one.determined.ravel()]
    return entries


def lines_of(found: "InverseMaterials") -> list[str]:
    """Lines that tell what was found."""
    lines = []
    for key, one in found.estimates.items():
        if _is_texture(key, one):
            lines.append(f"{key:>24}  {one.value.shape[0]} × {one.value.shape[1]} texels")
            continue
        entries = [
            f"{value:.4g} ({low:.4g} to {high:.4g})" if is_told else "not told"
            for value, low, high, is_told in zip(
                *(part.ravel() for part in (one.value, one.low, one.high, one.determined)), strict=True
            )
        ]
        lines.append(f"{key:>24}  {', '.join(entries)}")
    return [*lines, ""]


def _is_texture(key: str, estimate: "Estimate") -> bool:
    """Whether an estimate is of texels: of colours, rows and columns lead."""
    return estimate.value.ndim == 3 and not key.endswith(".C")


def write_materials(path: pathlib.Path, found: "InverseMaterials") -> None:
    """Materials as tables of a scene file; textures as .exr files beside it.

    Raises:
        InputError: for textures of lobes that are no Phong's, which scene files do not have.
    """
    import numpy as np

    from jaxrelight.files.whole_file import write_whole
    from jaxrelight.images import write_image

    lines = []
    for name, material in found.materials.items():
        textures = {}
        for key, one in found.estimates.items():
            owner, _, part = key.rpartition(".")
            if owner == name and _is_texture(key, one):
                image = path.with_name(f"{path.stem}-{name}-{part}.exr")
                write_image(image, np.ascontiguousarray(one.value.astype(np.float32)))
                textures[part] = f'"{image.name}"'
        lines += _toml_of(name, material, textures)
    write_whole(path, lambda partial: partial.write_text("\n".join(lines), encoding="utf-8"))


def _toml_of(name: str, material: "Brdf | Material", textures: dict[str, str]) -> list[str]:
    """The lines of one material."""
    import numpy as np

    from jaxrelight.brdf.lobes import LobeSum
    from jaxrelight.brdf.material import as_material

    def numbers(values: Any) -> str:
        return "[" + ", ".join(f"{float(x):.6g}" for x in np.ravel(np.asarray(values))) + "]"

    def colour(part: str, values: Any) -> str:
        return textures.get(part, numbers(np.broadcast_to(np.asarray(values), 3)))

    first, last = as_material(material).components[0].brdf, as_material(material).components[-1].brdf
    assert isinstance(first, LobeSum)
    assert isinstance(last, LobeSum)
    lines = [f'[material."{name}"]']
    if last.is_constant:
        return [*lines, 'type = "lambert"', f"albedo = {colour('albedo', first.diffuse)}", ""]
    C, n, scale = (np.asarray(of) for of in (last.C, last.exponent, last.scale))
    if C.shape[:2] == (1, 1) and np.allclose(C, [-1, -1, 1]):
        specular = 2 * np.pi * scale[0] / (n[0] + 2)
        lines += ['type = "phong"', f"diffuse = {colour('diffuse', first.diffuse)}"]
        return [*lines, f"specular = {colour('specular', specular)}", f"exponent = {float(n[0, 0]):.6g}", ""]
    if textures:
        raise InputError(f"'{name}': a scene file has no textures of such lobes; leave --output out")
    lobes = []
    for entries, exponents, peak in zip(C, n, scale, strict=True):
        direction = ", ".join(numbers(row) for row in entries)
        direction = direction if len(entries) == 1 else f"[{direction}]"
        exponent = f"{float(exponents[0]):.6g}" if len(exponents) == 1 else numbers(exponents)
        lobes.append(f"{{C = {direction}, exponent = {exponent}, peak = {numbers(peak)}}}")
    lines += ['type = "lafortune"', f"diffuse = {colour('diffuse', first.diffuse)}"]
    return [*lines, f"lobes = [{', '.join(lobes)}]", ""]


def write_report(folder: pathlib.Path, picture: Any, found: "InverseMaterials") -> None:
    """The picture, what was found and the difference, with one exposure."""
    import numpy as np

    from jaxrelight.images import auto_exposure, write_image

    exposure = auto_exposure(np.asarray(picture, np.float32))
    for name, pixels in (
        ("picture", picture),
        ("found", found.pictures[0]),
        ("difference", np.abs(np.asarray(picture) - found.pictures[0])),
    ):
        image = np.ascontiguousarray(np.asarray(pixels, np.float32))
        write_image(folder / f"{name}.exr", image)
        write_image(folder / f"{name}.png", image, exposure=exposure)
