"""Inputs and outputs that are URLs, through fsspec, which is loaded for them only."""
