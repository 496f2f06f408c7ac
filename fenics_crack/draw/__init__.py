"""Pictures, and files for ParaView."""
