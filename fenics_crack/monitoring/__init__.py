"""A crack from measurements: blade tip timing and identification."""
