"""True robots."""
