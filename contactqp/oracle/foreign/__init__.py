"""Answers of other codes: read as stated, completed, certified, with the right values beside."""
