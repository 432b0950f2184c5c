"""Fits of measured reflectance that feed the kernels of jaxrelight."""
