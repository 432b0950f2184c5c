"""Numbers and arrays: powers and norms with finite gradients, shapes in buckets, random numbers."""
