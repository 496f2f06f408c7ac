"""What every folder uses: errors, tables, progress, ranks, threads, and files read and written
safely."""
