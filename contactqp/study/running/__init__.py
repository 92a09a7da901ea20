"""Cells of a study run in processes of their own: streamed to a journal, resumed from it, one crash one cell."""
