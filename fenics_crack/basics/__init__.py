"""Parts that every folder uses: errors, tables, progress, ranks, threads, and files that are read
and written safely."""
