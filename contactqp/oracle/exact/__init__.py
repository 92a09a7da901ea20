"""Compute answers in rational numbers or intervals, with proofs."""
