"""Volumes to the formats of others: one module a format, listed in `registry`."""
