"""Reflectance: BRDFs in the local frame, their factors, and what transport needs of them."""
