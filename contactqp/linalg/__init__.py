"""Factorising, condensing, iterating and refining, in double and extended precision, independent of any method."""
