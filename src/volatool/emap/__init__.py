"""The spring system of EMap and its solver."""
