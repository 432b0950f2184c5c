"""Pictures against the number of factors of a BRDF (Wang 2006 §5.2.1, Figures 8 and 9)."""

import argparse
import contextlib
import pathlib
import tempfile

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared
from tests.benchmarks.pictures import contact_sheet

DRAGON = "dragon_vrip_res3.ply"
TERMS = 1, 2, 4, 8, 16
LIGHT_DIRECTION, LIGHT_COLOUR = (0.4, 0.7, 0.6), (1.0, 0.85, 0.6)
# Powers of the cosines of light and view in the error that the factors minimise.
COSINES = (0, 0), (0.25, 0.25), (0.5, 0.5), (0.5, 1), (1, 1), (0, 0.5), (0.5, 0), (1, 0)
MEASURED = "rgl_cc_ibiza_sunset_rgb.bsdf", "cornell_garnet_red.brdf"
ROTATIONS = 0, 130
# §5: the paper's anisotropic BRDF.
ANISOTROPIC = {"kd": 0.5, "ks": 0.75, "nu": 10, "nv": 100}


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.pictures_by_terms", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small pictures; RESULTS.md is left as it is")
    parser.add_argument("--pictures", type=pathlib.Path, help="write the sheets of pictures here")
    arguments = parser.parse_args()
    shared("data", "mesh")
    mesh, size, resolution = ("dragon_vrip_res4.ply", 48, 8) if arguments.quick else (DRAGON, 256, 64)
    parameters = (
        f"{mesh}, Ashikhmin–Shirley k_d {ANISOTROPIC['kd']}, k_s {ANISOTROPIC['ks']}, n_u "
        f"{ANISOTROPIC['nu']}, n_v {ANISOTROPIC['nv']}, {size}×{size} pixels; relative L2 against the BRDF itself"
    )
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report = stack.enter_context(Report("pictures_by_terms", "Pictures by terms", parameters, not arguments.quick))
        scene = dragon(mesh, size)
        single_light(report, scene, arguments.pictures)
        environment_light(report, scene, folder, resolution, arguments.pictures)
        many_lights(report, folder, arguments.quick)


def dragon(file: str, size: int):
    """The dragon alone, of the paper's BRDF, under Grace Cathedral."""
    from jaxrelight import Camera, Part, Scene, load_environment, load_mesh
    from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
    from jaxrelight.geometry.mesh import normalized

    mesh = normalized(load_mesh(shared("data", "mesh", file)), 1.0)
    camera = Camera((0.3, 0.75, 1.5), (0.0, 0.33, 0.0), (0.0, 1.0, 0.0), 40.0, size, size)
    light = load_environment(shared("data", "env", "grace_latlong.exr"), scale=10)
    return Scene([Part(mesh, "object")], {"object": ashikhmin_shirley(**ANISOTROPIC)}, camera, light, "dragon")


def factorings(brdf) -> dict:
    """Ways to write the BRDF, by name."""
    from jaxrelight import factor
    from jaxrelight.brdf.parametrisation import POLAR

    ways = {f"K = {k}": factor(brdf, k) for k in TERMS}
    for powers in ((0, 0), (1, 0), (0.5, 0.5), (1, 1)):
        ways[f"K = 4, cosines to {powers[0]}, {powers[1]}"] = factor(brdf, 4, cosine=powers)
    ways["K = 1, polar"] = factor(brdf, 1, parametrisation=POLAR)
    ways["K = 1, normalised"] = factor(brdf, 1, form="normalised")
    ways["K = 1, normalised, polar"] = factor(brdf, 1, form="normalised", parametrisation=POLAR)
    return ways


def single_light(report: Report, scene, pictures: pathlib.Path | None):
    """Figure 8: one coloured light, no shadows; the factors at every pixel."""
    import jax
    import jax.numpy as jnp

    from jaxrelight import image_error
    from jaxrelight.geometry.frame import tangent_frame
    from jaxrelight.geometry.gbuffer import trace_gbuffer
    from jaxrelight.geometry.surfaces import join
    from jaxrelight.geometry.tracer import Tracer

    surfaces = join([part.mesh for part in scene.parts])
    gbuffer = trace_gbuffer(surfaces, Tracer(surfaces), scene.camera)
    frames = tangent_frame(jnp.asarray(gbuffer.normals, jnp.float32))
    direction = jnp.asarray(LIGHT_DIRECTION) / np.linalg.norm(LIGHT_DIRECTION)
    omega_i, omega_o = frames @ direction, jnp.einsum("pxy,py->px", frames, jnp.asarray(gbuffer.omega_o, jnp.float32))
    lit = (omega_i[:, 2] > 0) & (omega_o[:, 2] > 0)

    def picture(reflectance) -> np.ndarray:
        radiance = jnp.where(lit[:, None], reflectance * omega_i[:, 2:] * 3 * jnp.asarray(LIGHT_COLOUR), 0)
        image = np.zeros((*gbuffer.covered.shape, 4), np.float32)
        image[gbuffer.covered] = np.concatenate([radiance, np.ones((len(radiance), 1))], axis=-1)
        return image

    brdf = scene.materials["object"]
    truth = picture(jax.jit(jax.vmap(brdf.evaluate))(omega_i, omega_o))
    shown, rows = {}, []
    for name, way in factorings(brdf).items():
        sides = (jax.jit(jax.vmap(side)) for side in (way.light_side, way.view_side))
        light, view = (side(omega) for side, omega in zip(sides, (omega_i, omega_o), strict=True))
        shown[name] = picture(jnp.sum(light * view, axis=1))
        error = image_error(shown[name], truth)
        rows.append([name, percent(error.trimmed), percent(error.untrimmed), f"{error.mean_ratio:.3f}"])
    report.text("**A single coloured light, no shadows** (Figure 8).")
    report.table(["factors", "trimmed", "untrimmed", "mean ratio"], rows)
    if pictures:
        contact_sheet(pictures / "one-light.png", {**shown, "the BRDF itself": truth}, 3, 0.0)


def environment_light(report: Report, scene, folder: pathlib.Path, resolution: int, pictures: pathlib.Path | None):
    """Figure 9: under an environment with shadows, from vertices, beside a grey diffuse BRDF."""
    from jaxrelight import Transport, factor, image_error, lambert, prepare
    from jaxrelight.lighting.transport import TransportRelighter

    def exact(receivers) -> TransportRelighter:
        method = Transport(receivers, resolution, terms=1, coefficients=1)
        relighter = prepare(scene, method, folder / receivers)
        assert isinstance(relighter, TransportRelighter)
        return relighter.exact()

    pixels, vertices = exact("pixels"), exact("vertices")
    truth = pixels.picture(background=False)
    view, shown, rows = vertices.view(), {}, []
    ways = {"grey diffuse": factor(lambert([ANISOTROPIC["kd"]] * 3)), **factorings(scene.materials["object"])}
    for name, way in ways.items():
        relighter = vertices.rebake([way])
        shown[name] = relighter.shade(relighter.light(scene.lights), view).rgba()
        error = image_error(shown[name], truth)
        rows.append([name, percent(error.trimmed), percent(error.untrimmed), f"{error.mean_ratio:.3f}"])
    report.text(
        f"**Under Grace Cathedral, with shadows** (Figure 9): vertices as receivers, resolution {resolution}, all "
        "coefficients; against pixel receivers."
    )
    report.table(["factors", "trimmed", "untrimmed", "mean ratio"], rows)
    if pictures:
        level = float(np.quantile(truth[truth[..., 3] > 0][:, :3].mean(axis=-1), 0.95))
        contact_sheet(pictures / "grace.png", {**shown, "the BRDF itself": truth}, 3, -np.log2(level) - 0.3)


def many_lights(report: Report, folder: pathlib.Path, quick: bool):
    """Which powers of the cosine to factor with: BRDFs, analytic and measured, on the bunny under every environment."""
    from jaxrelight import Camera, Part, Scene, Transport, factor, image_error, load_brdf, load_environment, load_mesh
    from jaxrelight.brdf.reflection import FixedView
    from jaxrelight.geometry.mesh import normalized
    from jaxrelight.lighting.prepare import prepare
    from jaxrelight.lighting.transport import TransportRelighter
    from tests.benchmarks.factor_error import brdfs

    materials = brdfs(shared("data", "published", "lafortune_published.json"))
    materials |= {name.split(".")[0]: load_brdf(shared("data", "brdf", name)).brdf for name in MEASURED}
    materials = dict(list(materials.items())[-1:]) if quick else materials
    files = sorted(shared("data", "env").iterdir())[: 1 if quick else None]
    lights = [load_environment(file, rotate_y) for file in files for rotate_y in ROTATIONS]
    size, resolution = (16, 8) if quick else (72, 32)
    camera = Camera((0.3, 0.9, 2.3), (0.0, 0.45, 0.0), (0.0, 1.0, 0.0), 28.0, size, size)
    bunny = Part(normalized(load_mesh(shared("data", "mesh", "bunny_mitsuba.ply")), 1.0), "object")
    method = Transport("pixels", resolution, coefficients=1)
    tables: dict[tuple, list] = {powers: [] for powers in COSINES[: 2 if quick else None]}
    for brdf in materials.values():
        scene = Scene([bunny], {"object": brdf}, camera, name="bunny")
        relighter = prepare(scene, method, folder / "many")
        assert isinstance(relighter, TransportRelighter)
        own = relighter.exact()
        view = own.view()
        truths = [own.shade(own.light(light), view).rgba() for light in lights]
        assert isinstance(own.transport.blocks[0].reflection, FixedView)
        for powers, cells in tables.items():
            whole = factor(brdf, max(TERMS), cosine=powers)
            errors = {k: [] for k in (4, max(TERMS))}
            way = own.rebake([whole])
            for light, truth in zip(lights, truths, strict=True):
                lit = way.light(light)
                for k, rows in errors.items():
                    # Singular vectors come in order, so that few terms are the first of many.
                    kept = (lit.terms[0].at[:, k:].set(0), *lit.terms[1:])
                    error = image_error(way.shade(lit._replace(terms=kept), view).rgba(), truth)
                    rows.append((error.trimmed, error.untrimmed))
            cells += [" / ".join(percent(value) for value in np.mean(rows, axis=0)) for rows in errors.values()]
    report.text(
        f"**Cosines in the factorisation**: the bunny alone, pixel receivers, {size}×{size}, resolution {resolution}, "
        f"all coefficients; against the BRDF itself, trimmed / untrimmed, means over {len(files)} environments at "
        f"rotations of {' and '.join(map(str, ROTATIONS))} degrees. The default is (0.5, 0.5)."
    )
    heads = [f"{name}, K = {k}" for name in materials for k in (4, max(TERMS))]
    report.table(["powers of light, view", *heads], [[str(powers), *cells] for powers, cells in tables.items()])


if __name__ == "__main__":
    main()
