"""A scene and a sky made by code: what the demo shows, and small real input for trials and tests."""

import numpy as np

from jaxrelight.brdf import lobes
from jaxrelight.geometry import mesh as meshes
from jaxrelight.geometry import primitives
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.lights.environment import Environment, environment
from jaxrelight.scene.scene import Part, Scene


def demo_scene(detail: float = 1.0, size: int = 480) -> Scene:
    """A glossy knot and a Lafortune ball among diffuse pillars, under an evening sky.

    Args:
        detail: factor on the number of quads along each side of every mesh.
        size: height of the image in pixels; it is 4/3 as wide.
    """

    def quads(count: int) -> int:
        return max(4, round(count * detail))

    def placed(mesh: Mesh, x: float, y: float, z: float) -> Mesh:
        matrix = np.eye(4)
        matrix[:3, 3] = x, y, z
        return meshes.transformed(mesh, matrix)

    knot = meshes.normalized(_trefoil(quads(160), quads(24)), 1.0)
    parts = [
        Part(primitives.plane((4.4, 4.4), quads(120)), "floor", "floor"),
        Part(placed(knot, 0, 0.005, 0), "lacquer", "knot"),
        Part(placed(primitives.sphere(0.2, quads(16)), 0.72, 0.2, 0.5), "brushed", "ball"),
    ]
    for i, angle in enumerate(np.radians([205, 232, 270, 308, 335])):
        height = 0.95 - 0.16 * (i % 2)
        pillar = primitives.box((0.13, height, 0.13), quads(11))
        parts.append(
            Part(placed(pillar, 1.25 * np.cos(angle), height / 2, 1.25 * np.sin(angle)), "stone", f"pillar {i}")
        )
    materials = {
        "floor": lobes.lambert([0.52, 0.50, 0.47]),
        "stone": lobes.lambert([0.70, 0.66, 0.58]),
        "lacquer": lobes.phong([0.42, 0.07, 0.05], [0.22, 0.20, 0.18], 12.0),
        "brushed": lobes.lobe_sum([0.05, 0.09, 0.16], [lobes.lobe([-1, -1, 0.95], 7.0, peak=[0.55, 0.6, 0.65])]),
    }
    camera = Camera((0.7, 1.0, 2.7), (0.0, 0.4, 0.0), fov_y=34.0, width=size * 4 // 3, height=size)
    return Scene(parts, materials, camera, evening_sky(), "demo")


def evening_sky(height: int = 256) -> Environment:
    """A lat-long sky: a low, hazy sun about 7° wide, a glow, a horizon, drifting clouds, sand below."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(2 * height) + 0.5) / (2 * height), indexing="ij")
    up = np.cos(np.pi * v)
    longitude = 2 * np.pi * (0.5 - u)
    direction = np.stack([np.sin(np.pi * v) * np.sin(longitude), up, np.sin(np.pi * v) * np.cos(longitude)], -1)

    zenith, horizon = np.array([0.10, 0.22, 0.55]), np.array([0.95, 0.62, 0.40])
    blend = np.clip(1 - up, 0, 1)[..., None] ** 4
    sky = zenith * (1 - blend) + horizon * blend
    sun = np.array([-0.75, 0.50, 0.42])
    sun /= np.linalg.norm(sun)
    to_sun = np.clip(direction @ sun, -1, 1)
    sky += np.array([1.0, 0.75, 0.45]) * (0.5 * np.exp((to_sun - 1) * 9))[..., None]
    cloud = _clouds(direction) * np.clip(up * 5, 0, 1)
    sky = sky * (1 - 0.55 * cloud[..., None]) + cloud[..., None] * np.array([0.75, 0.68, 0.66]) * 0.8
    ground = np.array([0.50, 0.42, 0.34]) * (0.45 + 0.55 * np.clip(1 + up * 2.5, 0, 1))[..., None]
    # A hazy horizon.
    above = np.clip(up / 0.12 + 0.5, 0, 1)[..., None]
    pixels = sky * above + ground * (1 - above)

    area = np.sin(np.pi * v) * (np.pi / height) ** 2
    disc = np.exp((to_sun - 1) * 250)
    irradiance = np.array([5.2, 4.1, 2.9])
    pixels += irradiance * (disc / np.sum(disc * area))[..., None]
    return environment(pixels, name="the demo's sky")


def _clouds(direction: np.ndarray) -> np.ndarray:
    """Smooth cover 0 … 1: octaves of waves on the plane of clouds above."""
    x = direction[..., 0] / (np.abs(direction[..., 1]) + 0.18)
    z = direction[..., 2] / (np.abs(direction[..., 1]) + 0.18)
    rng = np.random.default_rng(7)
    total = np.zeros_like(x)
    for octave in range(5):
        for _ in range(4):
            turn, phase = rng.uniform(0, 2 * np.pi, 2)
            wave = np.cos(turn) * x + np.sin(turn) * z
            total += 0.6**octave * np.sin(1.5 * 1.9**octave * wave + phase + 0.8 * np.sin(wave + phase))
    return np.clip(total * 0.22 + 0.1, 0, 1) ** 1.5


def _trefoil(along: int, around: int) -> Mesh:
    """A tube around a trefoil knot, with smooth normals."""
    t = np.arange(along) * (2 * np.pi / along)

    def curve(t):
        return np.stack([np.sin(t) + 2 * np.sin(2 * t), np.cos(t) - 2 * np.cos(2 * t), -1.15 * np.sin(3 * t)], axis=-1)

    tangent = curve(t + 1e-4) - curve(t - 1e-4)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    side = np.cross(tangent, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side, axis=-1, keepdims=True)
    other = np.cross(tangent, side)
    phi = np.arange(around) * (2 * np.pi / around)
    normals = np.cos(phi)[None, :, None] * side[:, None] + np.sin(phi)[None, :, None] * other[:, None]
    vertices = curve(t)[:, None] + 0.55 * normals
    i, j = np.meshgrid(np.arange(along), np.arange(around), indexing="ij")

    def number(i, j):
        return ((i % along) * around + j % around).ravel()

    a, b, c, d = number(i, j), number(i + 1, j), number(i + 1, j + 1), number(i, j + 1)
    faces = np.concatenate([np.stack([a, c, b], axis=-1), np.stack([a, d, c], axis=-1)])
    return Mesh(vertices.reshape(-1, 3), faces, normals.reshape(-1, 3))
