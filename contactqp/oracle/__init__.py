"""Exact and enclosed answers, other people's answers judged in words, and problems whose answers are known."""
