"""Stores, opened as what a test knows them to be."""

import pathlib

from jaxrelight.lighting.prepare import open_store
from jaxrelight.lighting.transport import TransportRelighter


def open_transport(folder: pathlib.Path) -> TransportRelighter:
    """The relighter of a store of transport."""
    relighter = open_store(folder)
    assert isinstance(relighter, TransportRelighter)
    return relighter
