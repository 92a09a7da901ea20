"""Parts of the pages that are written by a program: what the code says of itself, and what its cases hold."""
