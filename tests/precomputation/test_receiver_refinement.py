"""Vertices are added where light is not linear between them, nowhere else, and without cracks."""

import dataclasses
import pathlib
import tempfile

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.files import store as stores
from jaxrelight.geometry.subdivision import conforming, edges_of
from jaxrelight.geometry.triangles import area_vectors
from jaxrelight.precomputation import receiver_refinement
from jaxrelight.precomputation.receiver_refinement import _is_seen, refined, with_needed_vertices

CAMERA = jr.Camera((1.2, 1.6, 2.0), (0, 0.1, 0), fov_y=50, width=40, height=30)
SKY = jr.environment(np.ones((8, 16, 3), np.float32))


def room() -> jr.Scene:
    """A box over a floor of two triangles, of which one half is another part."""
    box = jr.transformed(jr.box([0.6, 0.2, 0.6]), _moved(0, 0.3, 0))
    halves = [jr.transformed(jr.plane((1, 2), 1), _moved(x, 0, 0)) for x in (-0.5, 0.5)]
    parts = [jr.Part(halves[0], "paper"), jr.Part(halves[1], "wood"), jr.Part(box, "paper")]
    return jr.Scene(parts, {"paper": jr.lambert(0.7), "wood": jr.lambert([0.6, 0.4, 0.2])}, CAMERA)


def _moved(*by: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


@pytest.fixture(scope="module")
def finer(tmp_path_factory) -> jr.Scene:
    return refined(room(), 0.1, tmp_path_factory.mktemp("store"), "key").scene


def test_without_a_store_there_are_the_same_vertices(finer):
    for with_store, without in zip(finer.parts, with_needed_vertices(room(), 0.1, 64).parts, strict=True):
        np.testing.assert_array_equal(with_store.mesh.vertices, without.mesh.vertices)
        np.testing.assert_array_equal(with_store.mesh.faces, without.mesh.faces)


def test_a_few_small_faces_of_many_are_not_halved():
    """The edges of a face are neither many nor around much of a plane of 3,200 faces, but of one of two."""
    for squares, seen in ((40, False), (1, True)):
        mesh = jr.plane((1, 1), squares)
        edges = edges_of(mesh)
        chosen = np.zeros(len(edges.ends), bool)
        chosen[edges.of_sides[0]] = True
        assert _is_seen(mesh, edges, chosen) == seen
    # Many edges of faces that are a small part of the area are those of a thing on a large floor.
    thing, floor = jr.plane((1, 1), 40), jr.plane((1e4, 1e4), 1)
    both = dataclasses.replace(
        thing,
        vertices=np.concatenate([thing.vertices, floor.vertices]),
        normals=np.concatenate([thing.normals, floor.normals]),
        faces=np.concatenate([thing.faces, floor.faces + len(thing.vertices)]),
        uv=None,
    )
    edges = edges_of(both)
    assert _is_seen(both, edges, edges.ends.max(axis=1) < len(thing.vertices))


def test_surfaces_stay_what_they_are(finer):
    for before, after in zip(room().parts, finer.parts, strict=True):
        areas = [np.linalg.norm(area_vectors(of.mesh.vertices[of.mesh.faces]), axis=1).sum() for of in (before, after)]
        np.testing.assert_allclose(areas[0], areas[1], rtol=1e-12)
        np.testing.assert_array_equal(after.mesh.vertices[: len(before.mesh.vertices)], before.mesh.vertices)
        np.testing.assert_allclose(np.linalg.norm(after.mesh.normals, axis=1), 1, rtol=1e-12)


def test_no_vertex_lies_inside_the_edge_of_another_face(finer):
    """Nor where two parts meet."""
    halves = [part.mesh for part in finer.parts[:2]]
    for mesh in halves:
        edges = edges_of(mesh)
        assert np.bincount(edges.of_sides.ravel()).max() <= 2
    rims = [np.unique(mesh.vertices[np.abs(mesh.vertices[:, 0]) < 1e-9], axis=0) for mesh in halves]
    assert len(rims[0]) > 2
    np.testing.assert_allclose(rims[0], rims[1], atol=1e-9)
    for mesh in halves:
        # An edge of one face alone would be a crack, unless it lies on the rim of its rectangle.
        edges = edges_of(mesh)
        ends = mesh.vertices[edges.ends[np.bincount(edges.of_sides.ravel()) == 1]][..., [0, 2]]
        rims = mesh.vertices[:, [0, 2]].min(axis=0), mesh.vertices[:, [0, 2]].max(axis=0)
        assert np.any([np.all(np.abs(ends - rim) < 1e-9, axis=1) for rim in rims], axis=(0, 2)).all()


def test_an_edge_is_halved_in_both_parts_that_meet_there():
    """Though only one of them asks for it."""
    meshes = [part.mesh for part in room().parts[:2]]
    edges = [edges_of(mesh) for mesh in meshes]
    lengths = [
        np.linalg.norm(np.diff(m.vertices[e.ends], axis=1)[:, 0], axis=-1) for m, e in zip(meshes, edges, strict=True)
    ]
    middles = [mesh.vertices[of.ends].mean(axis=1) for mesh, of in zip(meshes, edges, strict=True)]
    border = [np.abs(middle[:, 0]) < 1e-9 for middle in middles]
    chosen = conforming(meshes, edges, lengths, [border[0], np.zeros_like(border[1])], 1.0)
    assert border[0].sum() == 1
    for own, asked, length, of in zip(chosen, border, lengths, edges, strict=True):
        assert own[asked].all()
        # The longest side of each face is halved, too.
        sides = of.of_sides[own[of.of_sides].any(axis=1)]
        assert own[np.take_along_axis(sides, length[sides].argmax(axis=1)[:, None], axis=1)].all()


def test_vertices_are_where_shadows_are(finer):
    """Denser beside the box than away from it, and none on the upper side of the box, which sees open sky."""
    for part in finer.parts[:2]:
        corners = part.mesh.vertices[part.mesh.faces]
        area = np.linalg.norm(area_vectors(corners), axis=1) / 2
        near = np.abs(corners.mean(axis=1)[:, [0, 2]]).max(axis=1) < 0.5
        assert area[near].mean() < 0.5 * area[~near].mean()
    assert len(finer.parts[2].mesh.vertices) < 4 * len(room().parts[2].mesh.vertices)
    open_sky = dataclasses.replace(room(), parts=room().parts[2:])
    assert _count(refined_apart(open_sky)) == _count(open_sky)


def refined_apart(scene: jr.Scene) -> jr.Scene:
    """Without a store that is kept."""
    with tempfile.TemporaryDirectory() as folder:
        return refined(scene, 0.1, pathlib.Path(folder), "key").scene


def _count(scene: jr.Scene) -> int:
    return sum(len(part.mesh.vertices) for part in scene.parts)


def test_pictures_are_nearer_to_those_of_pixels(tmp_path, monkeypatch):
    method = jr.Transport("vertices", resolution=16, coefficients="all")
    exact = jr.prepare(room(), dataclasses.replace(method, receivers="pixels"), tmp_path / "exact").picture(SKY)
    errors = []
    for tolerance in (0.0, 0.1):
        chosen = dataclasses.replace(method, receiver_tolerance=tolerance)
        picture = jr.prepare(room(), chosen, tmp_path / "store").picture(SKY)
        errors.append(jr.image_error(picture, exact).trimmed)
    assert errors[1] < 0.03
    assert errors[0] > 4 * errors[1]
    # What is known is not traced again.
    monkeypatch.setattr(receiver_refinement, "_rounds", None)
    again = jr.prepare(room(), chosen, tmp_path / "store").picture(SKY)
    np.testing.assert_array_equal(again, picture)
    used = stores.layers_of(stores.read_header(tmp_path / "store"))
    assert any(name.startswith("refinement-") for name in used)
