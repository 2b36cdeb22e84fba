"""Benchmarks: what is fast, against what, on which machine. ``python -m benchmarks`` runs them all."""
