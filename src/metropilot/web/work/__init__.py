"""Functions of the worker processes; arguments and results are plain values."""
