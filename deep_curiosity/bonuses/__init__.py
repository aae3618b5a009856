"""Bonuses: curiosity, and the baselines that it is compared with, behind one contract."""
