"""Frozen data classes of problems, answers and verdicts, without algorithms."""
