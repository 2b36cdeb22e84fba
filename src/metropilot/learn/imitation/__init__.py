"""One driver for every line: lessons from the optimal plan, imitation, drives in closed loop."""
