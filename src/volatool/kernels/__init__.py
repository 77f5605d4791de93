"""Compiled loops: arrays in, arrays out; no files, no logging, no CRS."""
