"""Differentiable precomputed light transport and relighting in JAX."""
