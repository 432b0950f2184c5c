"""Coarse smooth meshes at the terminator: corrected shading normals and pure ones, against the smooth surface itself.

The smooth surface is that of curved PN triangles over the coarse mesh (Vlachos et al. 2001), finely tessellated, in a
picture by Mitsuba 3, which is not among this project's packages: `pip install mitsuba`.
"""

import argparse
import dataclasses
import importlib.util
import tempfile

import numpy as np
from scipy import ndimage

from tests.benchmarks.measuring import Report, percent, shared

# Directions to the light, unit length apart: from the side, so that the terminator is in the middle of the picture,
# from behind, and from in front.
TOWARDS = {"side": (1.0, 0.2, 0.1), "behind": (0.6, 0.5, -0.6), "front": (0.4, 0.5, 0.8)}
TESSELLATION = 12
ALBEDO = 0.5
SAMPLES = 64


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.terminator", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one mesh, small pictures; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    shared("data", "mesh", "teapot.obj")
    size = 96 if quick else 192
    has_mitsuba = importlib.util.find_spec("mitsuba") is not None
    rows = []
    for name, mesh in meshes(quick).items():
        for place, towards in list(TOWARDS.items())[: 1 if quick else None]:
            rows.append(compared(f"{name}, {place}", mesh, np.array(towards), size, has_mitsuba))
    parameters = f"pictures of {size}², albedo {ALBEDO}, one distant light, pixels that are covered whole"
    with Report("terminator", "The terminator of coarse smooth meshes", parameters, not quick) as report:
        if not has_mitsuba:
            report.text("Mitsuba is not installed: what is lit is taken from this program's own fine mesh.")
        report.table(
            (
                "mesh, light",
                "vertices",
                "lit pixels",
                "of them black, corrected",
                "… pure",
                "… corrected, not beside a shadow",
                "trimmed L2, corrected",
                "… pure",
                "untrimmed, corrected",
                "… pure",
            ),
            rows,
        )


def meshes(quick: bool) -> dict:
    """Coarse meshes with smooth normals."""
    import trimesh

    from jaxrelight.geometry.mesh import Mesh, load_mesh, normalized
    from jaxrelight.geometry.primitives import sphere

    ball = trimesh.creation.icosphere(1, 1.0)
    vertices = np.asarray(ball.vertices, float)
    coarse = {
        "icosphere": normalized(Mesh(vertices, np.asarray(ball.faces, np.int64), vertices), 2.0),
        "sphere of 8 segments": normalized(sphere(1.0, 8), 2.0),
    }
    if quick:
        return {"icosphere": coarse["icosphere"]}
    coarse["teapot"] = normalized(load_mesh(shared("data", "mesh", "teapot.obj")), 2.0)
    if importlib.util.find_spec("fast_simplification") is not None:
        for name in ("bunny_mitsuba.ply", "spot.obj"):
            fine = load_mesh(shared("data", "mesh", name), 180.0)
            welded = trimesh.Trimesh(fine.vertices, fine.faces, process=True, merge_tex=True, merge_norm=True)
            simple = welded.simplify_quadric_decimation(face_count=1000)
            normals = np.asarray(simple.vertex_normals, float)
            mesh = Mesh(np.asarray(simple.vertices, float), np.asarray(simple.faces, np.int64), normals)
            coarse[f"{name.split('_')[0].split('.')[0]} of {len(mesh.vertices)}"] = normalized(mesh, 2.0)
    return coarse


def compared(name: str, mesh, towards: np.ndarray, size: int, has_mitsuba: bool) -> tuple:
    """A row of the table."""
    from jaxrelight import Camera
    from jaxrelight.images import image_error

    towards = towards / np.linalg.norm(towards)
    camera = Camera((0, 1.4, 5), (0, 0.8, 0), fov_y=32.0, width=size, height=size)
    smooth = curved(mesh)
    reference, covered = by_mitsuba(smooth, towards, camera) if has_mitsuba else picture(smooth, towards, camera)
    ours = {}
    for way, pure in (("corrected", False), ("pure", True)):
        ours[way], alpha = picture(dataclasses.replace(mesh, pure_normals=pure), towards, camera)
        covered = np.minimum(covered, alpha)
    alpha = covered[..., None]
    # The largest radiance is albedo; a hundredth of it is lit, where the interpolated normal faces the light, too.
    lit = (covered > 0.999) & (reference[..., 0] > 0.01 * ALBEDO) & (cosines(mesh, towards, camera) > 0.01)
    black = {way: lit & (image[..., 0] < 1e-6) for way, image in ours.items()}
    # The edges of shadows that a coarse mesh casts are elsewhere than those of the smooth surface.
    beside = np.asarray(ndimage.binary_dilation(reference[..., 0] <= 0.01 * ALBEDO, iterations=2), bool)
    error = {
        way: image_error(image, np.concatenate([reference, alpha], axis=2).astype(np.float32))
        for way, image in ours.items()
    }
    return (
        name,
        len(mesh.vertices),
        int(lit.sum()),
        *(int(black[way].sum()) for way in ours),
        int((black["corrected"] & ~beside).sum()),
        *(percent(error[way].trimmed) for way in ours),
        *(percent(error[way].untrimmed) for way in ours),
    )


def cosines(mesh, towards: np.ndarray, camera) -> np.ndarray:
    """Of the interpolated normals of the coarse mesh, in every pixel."""
    from jaxrelight.geometry.gbuffer import trace_gbuffer
    from jaxrelight.geometry.surfaces import join
    from jaxrelight.geometry.tracer import Tracer

    surfaces = join([mesh])
    points = trace_gbuffer(surfaces, Tracer(surfaces), camera)
    values = np.zeros(points.covered.shape)
    values[points.covered] = points.normals @ towards
    return values


def picture(mesh, towards: np.ndarray, camera):
    """This project's picture of direct light, and coverage."""
    import jaxrelight as jr

    scene = jr.Scene([jr.Part(mesh, "skin")], {"skin": jr.lambert(ALBEDO)}, camera, jr.directional(-towards, np.pi))
    relighter = jr.prepare(scene, jr.Prefiltered())
    image = relighter.shade(relighter.light(scene.lights), relighter.view())
    return np.asarray(image.radiance), np.asarray(image.alpha)


def by_mitsuba(mesh, towards: np.ndarray, camera) -> tuple[np.ndarray, np.ndarray]:
    """Mitsuba's picture of direct light, and coverage."""
    import mitsuba as mi  # pyright: ignore[reportMissingImports]

    mi.set_variant("scalar_rgb")
    shape = mi.Mesh("smooth", len(mesh.vertices), len(mesh.faces), has_vertex_normals=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
    parameters["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
    parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
    parameters.update()
    folder = tempfile.TemporaryDirectory()
    path = f"{folder.name}/smooth.ply"
    shape.write_ply(path)
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "pixel_format": "rgba"}
    scene = mi.load_dict(
        {
            "type": "scene",
            "integrator": {"type": "direct"},
            "sensor": {
                "type": "perspective",
                "fov": camera.fov_y,
                "fov_axis": "y",
                "to_world": mi.ScalarTransform4f().look_at(camera.origin, camera.target, camera.up),
                "film": film | {"rfilter": {"type": "box"}},
                "sampler": {"type": "independent", "sample_count": SAMPLES},
            },
            "light": {
                "type": "directional",
                "direction": (-towards).tolist(),
                "irradiance": {"type": "rgb", "value": float(np.pi)},
            },
            "object": {
                "type": "ply",
                "filename": path,
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}},
            },
        }
    )
    pixels = np.asarray(mi.render(scene))
    return pixels[..., :3], pixels[..., 3]


def curved(mesh):
    """The curved PN triangles of a mesh, cubic in positions and quadratic in normals, at a fine grid of each."""
    from jaxrelight.geometry.mesh import Mesh

    n = TESSELLATION
    grid = [(i, j, n - i - j) for i in range(n + 1) for j in range(n + 1 - i)]
    number = {place: k for k, place in enumerate(grid)}
    u, v, w = np.array(grid, float).T[:, :, None] / n
    small = []
    for i, j, k in grid:
        if k:
            small.append([number[i, j, k], number[i + 1, j, k - 1], number[i, j + 1, k - 1]])
        if i and j:
            small.append([number[i, j, k], number[i - 1, j, k + 1], number[i, j - 1, k + 1]])
    corners, normals = mesh.vertices[mesh.faces], mesh.normals[mesh.faces]

    def edge(a: int, b: int) -> np.ndarray:
        """The control point near corner a towards b: on the tangent plane of a."""
        along = corners[:, b] - corners[:, a]
        return (
            2 * corners[:, a] + corners[:, b] - np.sum(along * normals[:, a], axis=1, keepdims=True) * normals[:, a]
        ) / 3

    def middle(a: int, b: int) -> np.ndarray:
        """The control normal of an edge."""
        along, both = corners[:, b] - corners[:, a], normals[:, a] + normals[:, b]
        bend = 2 * np.sum(along * both, axis=1, keepdims=True) / np.sum(along**2, axis=1, keepdims=True)
        mid = both - bend * along
        return mid / np.linalg.norm(mid, axis=1, keepdims=True)

    edges = {(a, b): edge(a, b) for a in range(3) for b in range(3) if a != b}
    mean = sum(edges.values()) / 6
    centre = mean + (mean - corners.mean(axis=1)) / 2
    weights = u, v, w
    points = sum(weights[a] ** 3 * corners[:, None, a] for a in range(3))
    points = points + sum(3 * weights[a] ** 2 * weights[b] * point[:, None] for (a, b), point in edges.items())
    points = points + 6 * u * v * w * centre[:, None]
    bent = sum(weights[a] ** 2 * normals[:, None, a] for a in range(3))
    bent = bent + sum(weights[a] * weights[b] * middle(a, b)[:, None] for a, b in ((0, 1), (1, 2), (2, 0)))
    bent = bent / np.linalg.norm(bent, axis=2, keepdims=True)
    faces = (np.arange(len(corners))[:, None, None] * len(grid) + np.array(small)).reshape(-1, 3)
    return Mesh(points.reshape(-1, 3), faces, bent.reshape(-1, 3))


if __name__ == "__main__":
    main()
