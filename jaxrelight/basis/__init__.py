"""The domains in which light is written down: cube-map texels and Haar coefficients."""
