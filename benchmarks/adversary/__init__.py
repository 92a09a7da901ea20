"""A standing adversary: it makes problems, candidates and files by a grammar, and looks for anything that is wrong."""
