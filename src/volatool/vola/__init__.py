"""Volumes: building them in bounded memory, holding them, their metadata."""
