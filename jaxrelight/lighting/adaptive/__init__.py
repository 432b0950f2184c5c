"""Shading where bandwidth asks (Bagher 2011)."""
