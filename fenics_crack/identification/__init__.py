"""The crack from measurements: its length and place, how sure they are, and where to measure."""
