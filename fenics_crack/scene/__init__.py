"""What may be asked for; nothing that computes."""
