"""Personal expressions: skin positions from muscles, a jaw and lids, by no mechanism of a compared method."""
