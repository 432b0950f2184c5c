"""From geometry and materials to transport operators."""
