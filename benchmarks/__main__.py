"""Run all benchmarks, or those named: ``python -m benchmarks plant --write docs/benchmarks.md``."""

from benchmarks import plant, startup
from benchmarks.report import run

run([plant.BENCHMARK, startup.BENCHMARK])
