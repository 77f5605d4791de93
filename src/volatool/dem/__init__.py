"""Elevation models: surfaces, grids, GeoTIFF."""
