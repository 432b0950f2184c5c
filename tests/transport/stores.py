"""Stores of transport, opened by tests, and their blocks."""

import pathlib

from jaxrelight.brdf.reflection import Reflection
from jaxrelight.lighting.prepare import open_store
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.methods import Transport
from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.scene.scene import Scene
from jaxrelight.transport.model import Block, PrecomputedTransport


def open_transport(folder: str | pathlib.Path) -> TransportRelighter:
    """A relighter of a store of transport."""
    relighter = open_store(folder)
    assert isinstance(relighter, TransportRelighter)
    return relighter


def load_transport(folder: str | pathlib.Path, header: dict | None = None) -> PrecomputedTransport:
    """What a store of transport holds."""
    transport = load(folder, header)
    assert isinstance(transport, PrecomputedTransport)
    return transport


def precomputed(scene: Scene, method: Transport, folder: str | pathlib.Path) -> PrecomputedTransport:
    """What a store holds after a scene was precomputed into it, as `prepare` opens it."""
    build = precompute(scene, method, folder)
    transport = load(build.folder, build.header, build.geometry)
    assert isinstance(transport, PrecomputedTransport)
    return transport


def block_of(transport: PrecomputedTransport, material: str) -> Block:
    """The only block of a material."""
    (block,) = (block for block in transport.blocks if block.material == material)
    return block


def number_of(transport: PrecomputedTransport, material: str) -> int:
    """The number of a material's first block."""
    return [block.material for block in transport.blocks].index(material)


def reflections_of(transport: PrecomputedTransport) -> list[Reflection]:
    """The reflections of all blocks."""
    return [block.reflection for block in transport.blocks]
