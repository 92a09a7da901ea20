"""Motions with contact: mass matrices, the steps of a motion, its schemes and its history."""
