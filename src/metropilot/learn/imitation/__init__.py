"""Imitation of the optimal plan on random sections, then tuning in closed loop: the generalist driver."""
