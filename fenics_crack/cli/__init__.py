"""The program ``fenics-crack``."""
