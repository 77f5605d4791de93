"""Names of the metadata that a volume can carry; a module that imports nothing."""

CHANNELS = ("rgb", "height", "returns", "intensity", "class")
"""What ``--meta`` knows, in the order of the bytes of a metadata word."""
