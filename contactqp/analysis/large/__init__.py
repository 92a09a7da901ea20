"""Solve large deformations: Newton's method with inequality constraints, load control, and paths through limit
points.
"""
