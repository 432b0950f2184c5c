"""Light sources."""
