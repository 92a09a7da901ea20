"""Certify an answer of any method: its violations, bounds on its errors, and its uniqueness."""
