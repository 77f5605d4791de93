"""Points, meshes, grids and rasters of other formats, one a module, as LAS files give them."""
