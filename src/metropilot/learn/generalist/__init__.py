"""One driver for every line: random worlds, lessons from the optimal plan, a network that imitates it."""
