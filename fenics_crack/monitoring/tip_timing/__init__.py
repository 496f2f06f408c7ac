"""Blade tip timing: when a vibrating tip passes stationary probes, and what the times tell."""
