"""Points that stand for all surfaces, and light that is gathered from them."""
