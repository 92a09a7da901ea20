"""Compute exact and enclosed answers, diagnose foreign answers in words, and provide problems with known answers."""
