"""Nodes of glTF files: where they stand, and the instances, skins, lights and cameras that they bring."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.file_lights import FileCamera, FileLight, Surroundings
from jaxrelight.geometry.gltf_content import Content

_MAX_INSTANCES = 2**22
# Extensions of nodes that are read.
_OF_NODES = ("EXT_mesh_gpu_instancing", "KHR_lights_punctual", "KHR_node_visibility")


class Node(NamedTuple):
    """A node that is in the scene.

    Attributes:
        number: its number in the file.
        entry: its description.
        matrix: from its coordinates to the file's.
    """

    number: int
    entry: dict[str, Any]
    matrix: Float[np.ndarray, "4 4"]


def scene_nodes(content: Content) -> Iterator[Node]:
    """All nodes of the default scene; of all nodes, where there is no scene."""
    nodes, scenes = content.entries("nodes"), content.entries("scenes")
    if scenes:
        roots = scenes[content.json.get("scene", 0)].get("nodes", [])
        if len(scenes) > 1:
            content.note(f"it has {len(scenes)} scenes; the default one is taken")
    else:
        roots = set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])}
    waiting = [(number, np.eye(4)) for number in sorted(roots)]
    visited = set()
    while waiting:
        number, above = waiting.pop()
        if number in visited or number < 0:
            raise InputError(f"node {number} is below several others; export it again")
        visited.add(number)
        node = nodes[number]
        if node.get("extensions", {}).get("KHR_node_visibility", {}).get("visible", True) is False:
            content.note("nodes that the file hides are left out (KHR_node_visibility)")
            continue
        left_out = sorted(name for name in node.get("extensions", {}) if name not in _OF_NODES)
        if left_out:
            content.note(f"extensions are left out: {', '.join(str(name)[:40] for name in left_out)}")
        matrix = above @ own_matrix(node)
        waiting += [(child, matrix) for child in node.get("children", [])]
        yield Node(number, node, matrix)


def own_matrix(node: dict) -> Float[np.ndarray, "4 4"]:
    """A node's own transform: column by column, or translation · rotation · scale."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    turn = np.array(node.get("rotation", [0, 0, 0, 1]), float)
    return _placed(node.get("translation", [0, 0, 0]), turn, node.get("scale", [1, 1, 1]))


def _placed(translation: Any, quaternion: np.ndarray, scale: Any) -> Float[np.ndarray, "*n 4 4"]:
    """Translation · rotation · scale, of one or of many."""
    x, y, z, w = np.moveaxis(quaternion, -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    turn = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    matrix = np.zeros((*turn.shape[:-2], 4, 4))
    matrix[..., :3, :3] = turn * np.array(scale, float)[..., None, :]
    matrix[..., :3, 3] = translation
    matrix[..., 3, 3] = 1
    return matrix


def instances(content: Content, node: Node) -> Float[np.ndarray, "n 4 4"]:
    """Where a node's mesh stands: once, or at each instance of EXT_mesh_gpu_instancing."""
    extension = node.entry.get("extensions", {}).get("EXT_mesh_gpu_instancing")
    if extension is None:
        return node.matrix[None]
    names, rows = extension.get("attributes", {}), {}
    for name, width in (("TRANSLATION", 3), ("ROTATION", 4), ("SCALE", 3)):
        if name in names:
            if content.entries("accessors")[names[name]]["count"] > _MAX_INSTANCES:
                raise InputError(f"has more than {_MAX_INSTANCES:,} instances of a mesh; export less of it")
            rows[name] = content.accessor(names[name], width).astype(float)
    lengths = {len(values) for values in rows.values()}
    if len(lengths) > 1:
        raise InputError("the attributes of its instances differ in length; export it again")
    count = lengths.pop() if lengths else 1
    moved = rows.get("TRANSLATION", np.zeros((count, 3)))
    turned = rows.get("ROTATION", np.tile([0.0, 0, 0, 1], (count, 1)))
    scaled = rows.get("SCALE", np.ones((count, 3)))
    return node.matrix @ _placed(moved, turned, scaled)


def all_matrices(content: Content) -> list[Float[np.ndarray, "4 4"]]:
    """From the coordinates of each node to the file's; joints may be outside of the scene."""
    nodes = content.entries("nodes")
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}
    matrices: dict[int, np.ndarray] = {}
    for number in range(len(nodes)):
        chain = [number]
        while chain[-1] not in matrices and chain[-1] in parents:
            chain.append(parents[chain[-1]])
            if len(chain) > len(nodes):
                raise InputError(f"node {number} is below itself; export it again")
        for one in reversed(chain):
            if one not in matrices:
                above = matrices[parents[one]] if one in parents else np.eye(4)
                matrices[one] = above @ own_matrix(nodes[one])
    return [matrices[number] for number in range(len(nodes))]


def joint_matrices(content: Content, skin: int) -> Float[np.ndarray, "j 4 4"]:
    """What the joints of a skin do to vertices that follow them, as the joints stand: joint · inverse bind matrix."""
    entry, matrices = content.entries("skins")[skin], all_matrices(content)
    joints = np.stack([matrices[joint] for joint in entry["joints"]])
    if "inverseBindMatrices" not in entry:
        return joints
    inverse = content.accessor(entry["inverseBindMatrices"], 16).astype(float)
    if len(inverse) < len(joints):
        raise InputError("a skin has fewer inverse bind matrices than joints; export it again")
    return joints @ inverse[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)


def surroundings(content: Content, nodes: list[Node]) -> Surroundings:
    """The lights of KHR_lights_punctual and the perspective cameras of some nodes."""
    lights = content.json.get("extensions", {}).get("KHR_lights_punctual", {}).get("lights", [])
    placed, cameras = [], []
    for node in nodes:
        asked = node.entry.get("extensions", {}).get("KHR_lights_punctual")
        if asked is not None:
            placed.append(_light(content, lights[asked["light"]], node))
        if "camera" in node.entry:
            entry = content.entries("cameras")[node.entry["camera"]]
            name = str(entry.get("name") or node.entry.get("name") or f"camera {node.entry['camera']}")[:60]
            if entry.get("type") == "perspective" and "perspective" in entry:
                cameras.append(_camera(name, entry["perspective"], node.matrix))
            else:
                content.note(f"the camera '{name}' is left out: only perspective ones are read")
    return Surroundings(placed, cameras)


def _light(content: Content, entry: dict, node: Node) -> FileLight:
    kind, spot = entry["type"], entry.get("spot", {})
    if kind not in ("directional", "point", "spot"):
        raise InputError(f"a light is of the type {str(kind)[:40]!r}, which glTF does not know; export it again")
    if "range" in entry:
        content.note("the range of lights is left out: they fall off by the square of the distance")
    intensity = float(entry.get("intensity", 1)) * np.array(entry.get("color", [1, 1, 1]), float)
    if intensity.shape != (3,) or not np.isfinite(intensity).all() or (intensity < 0).any():
        raise InputError("a light's intensity is not finite or negative; export it again")
    along, length = -node.matrix[:3, 2], np.linalg.norm(node.matrix[:3, 2])
    return FileLight(
        kind,
        intensity,
        node.matrix[:3, 3],
        along / length if length > 0 else np.array([0.0, 0, -1]),
        float(np.degrees(spot.get("innerConeAngle", 0))),
        float(np.degrees(spot.get("outerConeAngle", np.pi / 4))),
        str(entry.get("name") or node.entry.get("name") or kind)[:60],
    )


def _camera(name: str, entry: dict, matrix: Float[np.ndarray, "4 4"]) -> FileCamera:
    axes = matrix[:3, :3] / np.maximum(np.linalg.norm(matrix[:3, :3], axis=0), 1e-30)
    aspect = float(entry["aspectRatio"]) if "aspectRatio" in entry else None
    return FileCamera(matrix[:3, 3], -axes[:, 2], axes[:, 1], float(np.degrees(entry["yfov"])), aspect, name)
