"""Meshes, cameras, rays and what they hit."""
