"""Entries of `fitting`: what its functions of arrays can be differentiated in, see `jaxrelight.gradients`."""

from jaxrelight.gradients.entry import Entries

ENTRIES: Entries = ()
