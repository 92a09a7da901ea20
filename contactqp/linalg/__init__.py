"""Factorising, condensing, iterating and refining, in double and extended precision; it knows no method."""
