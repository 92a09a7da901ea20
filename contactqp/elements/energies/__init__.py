"""Quadratic energies with constraints that are no contacts: what only pulls, only pushes, is bounded, or yields."""
