"""Quadratic energies with constraints that are no contacts: parts that only pull, only push, are bounded, or yield."""
