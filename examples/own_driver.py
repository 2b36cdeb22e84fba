"""A driver of one's own that stops well: control laws composed, registered, driven on four sections."""

from typing import NamedTuple

from metropilot import control
from metropilot.evaluate import RunSpec, checks, kpis_of
from metropilot.sim import AbstractDriver, Observation, Run, drive, register

RESERVE_S = 1.0  # build-up and release of the brake, which the forecast leaves out


class CruiseMemory(NamedTuple):
    """Memory of the driver: trainset and section, speeds to keep under, forecast, stop, state."""

    model: control.Model
    ceiling: control.Ceiling
    forecast: control.Forecast
    curve: control.StopCurve
    estimate: control.StateEstimate
    hold_mps: float = 0.0
    braking: bool = False


@register
class Cruise(AbstractDriver):
    """Hold the slowest speed that arrives on time, coast above it, stop at the mark."""

    id = "cruise"

    def init(self, run: Run) -> CruiseMemory:
        """Look at the section once."""
        model, ceiling = control.model_of(run, run.section), control.ceiling_of(run, run.section)
        estimate = control.initial_estimate(model)
        slope = control.weakest_gradient(model, run.section.length_m)
        rate = 0.9 * control.comfortable_deceleration(model, estimate, slope)
        curve = control.curve_for(model.vehicle, run.dt, rate)
        return CruiseMemory(model, ceiling, control.forecast_of(model, ceiling, rate), curve, estimate)

    def act(self, memory: CruiseMemory, observation: Observation) -> tuple[float, CruiseMemory]:
        """Stop if the brake is due; else hold, or coast, under the ceiling."""
        model, ceiling, forecast, curve, estimate, hold, braking = memory
        now_s, length_m = observation.time_s, float(model.track.length_m)
        estimate = control.update_estimate(model, estimate, *observation[1:4])
        ahead = control.look_ahead(model, estimate)
        stop = control.stop_command(model, ahead, length_m, curve)
        share = stop.share
        braking = braking or stop.required_mps2 >= curve.deceleration_mps2
        if not braking:
            if (now_s + 0.05) % 3.0 < 0.1:  # every three seconds: which speed arrives on time?
                place, left_s = ahead.position_m, observation.scheduled_time_s - now_s - RESERVE_S
                hold = control.cruise_for(forecast, place, ahead.speed_mps, left_s, length_m)
            coasts = ahead.speed_mps >= hold
            wanted = control.ceiling_acceleration(model, ahead, ceiling, 99.0 if coasts else hold, curve)
            most = 0.0 if coasts else control.traction_limit(estimate, ahead, ceiling)
            share = min(ahead.share_for(wanted), most)
        memory = memory._replace(estimate=control.record_command(estimate, share))
        return share, memory._replace(hold_mps=hold, braking=braking)


for section, time_s in ("RJ-WYJ", 110), ("WHY-WYJ", 140), ("XHM-JG", 180), ("SJZ-XC", 210):
    spec = RunSpec("yizhuang", *section.split("-"), time_s=time_s, driver="cruise")
    kpis = kpis_of(drive(spec.run(), spec.make_driver()), optimum=None)
    print(section, *(f"| {check.name}: {check.value}" for check in checks(kpis)))
    assert all(check.passed for check in checks(kpis))
