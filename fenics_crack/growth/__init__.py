"""Growth of a crack by the vibration of its plate, over the cycles."""
