"""Experiments that compute the tables and figures of the documentation."""
