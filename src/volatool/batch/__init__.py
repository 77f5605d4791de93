"""Many tiles: arguments to inputs, output names, one report each."""
