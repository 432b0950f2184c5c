"""Files of measured reflectance: MERL .binary, RGL .bsdf and Cornell .brdf, told apart by what is in them."""

from jaxrelight.brdf.files.load import BrdfFile, load_brdf

__all__ = ["BrdfFile", "load_brdf"]
