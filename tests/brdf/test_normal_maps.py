"""Normal maps and tangents along texture coordinates."""

import dataclasses

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Part, Scene
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.normal_maps import apply_normal_map
from jaxrelight.brdf.texture import Texture
from jaxrelight.geometry import mesh as meshes
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.geometry.surfaces import join
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute
from tests.opening import open_transport

SETTINGS = Transport("pixels", receiver_tolerance=0, resolution=8, terms=2, coefficients="all", factor_resolution=12)
LIGHT = np.random.default_rng(6).gamma(0.4, size=(6 * 8**2, 3)).astype(np.float32)


def _map(*normal: float) -> Texture:
    return Texture(jax.device_put(np.tile((np.array(normal, np.float32) + 1) / 2, (2, 2, 1))))


def _bumpy(brdf, bumps: Texture) -> Material:
    return Material((Component(brdf),), bumps)


@pytest.mark.parametrize("shape", [jr.plane((2, 1), 3), jr.box((1, 2, 3), 2)])
def test_a_map_bends_towards_growing_u_and_v(shape):
    """Against finite differences: the position as a function of (u, v) on each face."""
    turn = np.eye(4)
    turn[:3, :3] = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn[:3, 0] *= np.sign(np.linalg.det(turn[:3, :3]))
    surfaces = join([meshes.transformed(shape, turn)])
    along = apply_normal_map(surfaces.normals, surfaces.u_axes, surfaces.uv, _map(0.6, 0.0, 0.8))
    across = apply_normal_map(surfaces.normals, surfaces.u_axes, surfaces.uv, _map(0.0, 0.6, 0.8))
    for face in surfaces.faces:
        (a, b, c), uv = surfaces.vertices[face], surfaces.uv[face]
        to_uv = np.stack([uv[1] - uv[0], uv[2] - uv[0]])
        s, t = (axis / np.linalg.norm(axis) for axis in np.linalg.solve(to_uv, np.stack([b - a, c - a])))
        normal = surfaces.normals[face[0]]
        np.testing.assert_allclose(along[face[0]], 0.6 * s + 0.8 * normal, atol=1e-6)
        np.testing.assert_allclose(across[face[0]], 0.6 * t + 0.8 * normal, atol=1e-6)


def test_mirrored_texture_coordinates_turn_v_not_the_normal():
    plane = jr.plane((1, 1), 2)
    assert plane.uv is not None
    mirrored = join([dataclasses.replace(plane, uv=plane.uv * [-1, 1])])
    bent = apply_normal_map(mirrored.normals, mirrored.u_axes, mirrored.uv, _map(0.48, 0.36, 0.8))
    np.testing.assert_allclose(bent, np.broadcast_to([-0.48, 0.8, -0.36], bent.shape), atol=1e-6)


def _picture(mesh, material, folder, receivers="pixels") -> np.ndarray:
    camera = jr.Camera((0.3, 1.5, 1.0), (0, 0, 0), fov_y=40, width=12, height=10)
    scene = Scene([Part(mesh, "it")], {"it": material}, camera)
    made = precompute(scene, dataclasses.replace(SETTINGS, receivers=receivers), folder)
    assert len(made.notes) == (receivers == "vertices" and isinstance(material, Material))
    relighter = open_transport(made.folder)
    return np.asarray(relighter.shade_terms(relighter.terms(LIGHT), relighter.view()))


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_a_tilted_map_is_a_mesh_with_tilted_normals(tmp_path, receivers):
    plane, gloss = jr.plane((2, 2), 3), jr.phong(0.3, 0.4, 5.0)
    flat = _picture(plane, gloss, tmp_path / "0", receivers)
    np.testing.assert_allclose(
        _picture(plane, _bumpy(gloss, _map(0, 0, 1)), tmp_path / "1", receivers), flat, rtol=1e-4, atol=1e-5
    )
    normals = np.broadcast_to([0.36, 0.8, -0.48], plane.normals.shape)
    tilted = dataclasses.replace(plane, normals=normals, pure_normals=True)
    wanted = _picture(tilted, gloss, tmp_path / "2", receivers)
    image = _picture(plane, _bumpy(gloss, _map(0.36, 0.48, 0.8)), tmp_path / "3", receivers)
    np.testing.assert_allclose(image, wanted, rtol=1e-4, atol=1e-5)
    assert np.abs(image - flat).max() > 0.01


def test_slopes_that_face_away_from_the_eye_are_not_black(tmp_path):
    plane, paper = jr.plane((2, 2), 3), jr.lambert(0.5)
    seen = _picture(plane, paper, tmp_path / "0") > 0
    steep = np.array([0.0, 0.96, 0.28])  # away from the camera, towards −z
    np.testing.assert_array_equal(_picture(plane, _bumpy(paper, _map(*steep)), tmp_path / "1") > 0, seen)
    assert seen.any()


def test_tangents_follow_u_where_asked():
    turn = np.eye(4)
    turn[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    plane = meshes.transformed(jr.plane((1, 1), 2), turn)
    surfaces = join([plane, dataclasses.replace(plane, uv_tangents=True)])
    normals, tangents = (array.astype(np.float32) for array in (surfaces.normals, surfaces.tangents))
    frames, count = np.asarray(tangent_frame(normals, tangents)), len(plane.vertices)
    np.testing.assert_allclose(frames[:count], tangent_frame(normals)[:count], atol=1e-6)
    np.testing.assert_allclose(frames[count:, 0], np.broadcast_to([0, 0, -1], (count, 3)), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=1e-6)


def test_isotropic_pictures_do_not_depend_on_tangents(tmp_path):
    plane, gloss = jr.plane((2, 2), 3), jr.phong(0.3, 0.4, 5.0)
    wanted = _picture(plane, gloss, tmp_path / "0")
    image = _picture(dataclasses.replace(plane, uv_tangents=True), gloss, tmp_path / "1")
    np.testing.assert_allclose(image, wanted, rtol=1e-4, atol=1e-5)
