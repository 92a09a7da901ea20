"""Provide problems with answers known exactly by construction."""
