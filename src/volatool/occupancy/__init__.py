"""How full the blocks of each level are, and the depth that follows."""
