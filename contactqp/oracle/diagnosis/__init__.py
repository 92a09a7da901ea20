"""What went wrong with an answer, in words: one family of causes a module."""
