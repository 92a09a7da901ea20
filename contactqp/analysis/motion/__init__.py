"""Compute motions with contact: mass matrices, time steps, schemes and histories."""
