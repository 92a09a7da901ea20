"""Numerical stability: axes of difficulty swept with exact truths, and what every method makes of them."""
