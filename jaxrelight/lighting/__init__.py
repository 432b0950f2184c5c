"""From light to pictures."""
