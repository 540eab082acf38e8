"""Personal expressions: a generator of skin positions from muscles, a jaw and lids that no compared method implements."""
