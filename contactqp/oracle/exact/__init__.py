"""Exact and enclosed answers: rational numbers, intervals, and the proofs of them."""
