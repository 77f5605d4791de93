"""Streams of points from LAS, LAZ and COPC files, their CRS and their selection."""
