"""A crack from measurements: identification, and tip timing of scenes."""
