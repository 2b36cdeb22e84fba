"""Live runs, each stepped by its own process and watched by any number of viewers."""
