"""Drive one section near the energy optimum and print its key figures.

python examples/drive_a_section.py
"""

from metropilot.evaluate import RunSpec, checks, kpis_of, optimum_of
from metropilot.sim import drive


def main() -> None:
    request = RunSpec("yizhuang", "RJ", "WYJ", time_s=101.0, trainset="dkz32:AW2", driver="optimal")
    driven = drive(request.run(), request.make_driver())
    kpis = kpis_of(driven, optimum_of(driven))
    print(f"{kpis.outcome} after {kpis.running_time_s:.1f} s, {kpis.stopping_error_m:+.3f} m from the stop")
    print(f"{kpis.energy_wheel_kwh:.2f} kWh at the wheel, the optimum is {kpis.optimal_energy_kwh:.2f} kWh")
    for check in checks(kpis):
        print(f"{'ok  ' if check.passed else 'FAIL'} {check.name}: {check.value} ({check.wanted})")


if __name__ == "__main__":
    main()
