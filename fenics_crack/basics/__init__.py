"""Serve every folder: errors, tables, progress, ranks, threads, safe reading and writing."""
