"""Solutions followed along a parameter."""
