"""The papers' experiments, made again: terrain, sensor, baseline, scores, tables and figures."""
