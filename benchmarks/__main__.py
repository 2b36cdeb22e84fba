"""Run all benchmarks, or those named: ``python -m benchmarks plant --write docs/benchmarks.md``."""

from benchmarks import decision, joint_plan, learn, learned, plan, plant, startup, task
from benchmarks.report import run

run(
    [
        plan.BENCHMARK,
        joint_plan.BENCHMARK,
        plant.BENCHMARK,
        startup.BENCHMARK,
        decision.BENCHMARK,
        task.BENCHMARK,
        learn.BENCHMARK,
        learned.BENCHMARK,
    ]
)
