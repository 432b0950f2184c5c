"""Linear maps from light to radiance, all with one contract."""
