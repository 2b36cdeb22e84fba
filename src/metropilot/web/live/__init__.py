"""Live runs: each is stepped by a process of its own, and watched by any number of viewers."""
