"""Run all benchmarks, or those named: ``python -m benchmarks plant --write docs/benchmarks.md``."""

from benchmarks import plant
from benchmarks.report import run

run([plant.BENCHMARK])
