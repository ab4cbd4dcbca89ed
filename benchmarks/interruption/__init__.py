"""What a run folder holds after a fault, and whether a resumed run gives the same draws."""
