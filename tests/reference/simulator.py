"""A second opinion on the plant: slow, plain Python in float64, from the railway schema alone.

It shares no code with ``metropilot.physics`` and takes the longest, most literal way: it sums gradient times
overlap between tail and head, integrates clothoids by quadrature, walks through effort pieces, keeps every
command ever given and averages the delayed one over the step. Agreement with the plant is therefore evidence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from itertools import pairwise

from metropilot.railway import Efficiency, EffortCurve, Section, Trainset


def effort_n(curve: EffortCurve, speed_mps: float) -> float:
    """Force of an effort curve at one speed, by walking through its pieces."""
    held = curve.pieces[0]
    for piece in curve.pieces:
        if piece.from_mps <= speed_mps:
            held = piece
    force = sum(c * speed_mps**k for k, c in enumerate(held.polynomial))
    force += held.power_w / max(speed_mps, 1e-3)
    return min(max(force, 0.0), held.cap_n)


def bilinear(efficiency: Efficiency, speed_mps: float, share: float) -> float:
    """Value of an efficiency map, held outside its corners."""

    def weights(points: list[float], x: float) -> dict[int, float]:
        if x <= points[0]:
            return {0: 1.0}
        for k in range(len(points) - 1):
            if x < points[k + 1]:
                part = (x - points[k]) / (points[k + 1] - points[k])
                return {k: 1.0 - part, k + 1: part}
        return {len(points) - 1: 1.0}

    rows = weights([float(v) for v in efficiency.speed_mps], speed_mps)
    columns = weights([float(e) for e in efficiency.effort_share], share)
    return sum(a * b * float(efficiency.value[i, j]) for i, a in rows.items() for j, b in columns.items())


def step_mean(starts: list[float], values: list[float], low: float, high: float) -> float:
    """Mean of a piecewise-constant profile between two positions; its value at ``high`` if both are one."""
    edges = [-math.inf, *starts[1:], math.inf]
    if high <= low:
        return next(v for a, b, v in zip(edges[:-1], edges[1:], values, strict=True) if a <= high < b)
    total = 0.0
    for a, b, value in zip(edges[:-1], edges[1:], values, strict=True):
        overlap = min(b, high) - max(a, low)
        if overlap > 0:
            total += overlap * value
    return total / (high - low)


@dataclass
class ReferenceState:
    """State of the simulator after each step."""

    time_s: float = 0.0
    position_m: float = 0.0
    speed_mps: float = 0.0
    acceleration_mps2: float = 0.0
    share: float = 0.0
    traction_n: float = 0.0
    electric_brake_n: float = 0.0
    friction_brake_n: float = 0.0
    resistance_n: float = 0.0
    gradient_n: float = 0.0
    traction_j: float = 0.0
    electric_brake_j: float = 0.0
    line_j: float = 0.0
    recovered_j: float = 0.0


@dataclass
class ReferenceSimulator:
    """One trainset on one section; without emergency brake.

    Attributes:
        section: Section.
        trainset: Trainset with its load.
        state: Where it is.
        commands: Every command given so far, oldest first, one a step.
    """

    section: Section
    trainset: Trainset
    state: ReferenceState = field(default_factory=ReferenceState)
    commands: list[float] = field(default_factory=list)

    # ---- what holds back
    def gradient_n(self, head_m: float) -> float:
        """Weight times the mean gradient under the trainset."""
        profile = self.section.gradient_permil
        mean = step_mean(list(profile.from_m), list(profile.value), head_m - self.trainset.length_m, head_m)
        return self.trainset.mass_kg * self.trainset.gravity_mps2 * mean / 1000.0

    def curvature(self, position_m: float) -> float:
        """Signed curvature of the track at a position, 1/m."""
        curves = self.section.curves
        value = 0.0
        for k, curve in enumerate(curves):
            if curve.from_m <= position_m:
                value = curve.curvature_start_per_m
                if k + 1 < len(curves):
                    part = (position_m - curve.from_m) / (curves[k + 1].from_m - curve.from_m)
                    value += part * (curve.curvature_end_per_m - curve.curvature_start_per_m)
        return value

    def specific_curve_n_per_kg(self, position_m: float) -> float:
        """Curve resistance per kilogram at a position."""
        curvature = abs(self.curvature(position_m))
        if self.trainset.curve_formula == "none" or curvature == 0.0:
            return 0.0
        radius = 1.0 / curvature
        if self.trainset.curve_formula == "600/r":
            return 600.0 / radius / 1000.0 * self.trainset.gravity_mps2
        return 6.3 / (radius - 55.0)

    def curve_n(self, head_m: float) -> float:
        """Mass times the mean specific curve resistance under the trainset (midpoint rule between breaks)."""
        length = self.trainset.length_m
        if length == 0.0:
            return self.trainset.mass_kg * self.specific_curve_n_per_kg(head_m)
        breaks = [c.from_m for c in self.section.curves if head_m - length < c.from_m < head_m]
        edges = [head_m - length, *breaks, head_m]
        total = 0.0
        for a, b in pairwise(edges):
            count = max(1, math.ceil((b - a) / 1.0)) if self._bends(a, b) else 1
            width = (b - a) / count
            total += sum(self.specific_curve_n_per_kg(a + (k + 0.5) * width) * width for k in range(count))
        return self.trainset.mass_kg * total / length

    def _bends(self, low_m: float, high_m: float) -> bool:
        near = 1e-9 * (1.0 + abs(high_m))
        return self.curvature(low_m + near) != self.curvature(high_m - near)

    def tunnel_n(self, head_m: float, speed_mps: float) -> float:
        """Tunnel coefficient times the share of the trainset inside, times speed squared."""
        table = sorted(self.trainset.tunnel_n_per_mps2)
        force = 0.0
        for tunnel in self.section.tunnels if table else ():
            end = tunnel.from_m + tunnel.length_m
            length = self.trainset.length_m
            if length == 0.0:
                inside = 1.0 if tunnel.from_m <= head_m < end else 0.0
            else:
                inside = max(0.0, min(end, head_m) - max(tunnel.from_m, head_m - length)) / length
            force += inside * self._tunnel_coefficient(table, tunnel.cross_section_m2) * speed_mps**2
        return force

    @staticmethod
    def _tunnel_coefficient(table: list[tuple[float, float]], area_m2: float) -> float:
        if area_m2 <= table[0][0]:
            return table[0][1]
        for (a, low), (b, high) in pairwise(table):
            if area_m2 <= b:
                return low + (high - low) * (area_m2 - a) / (b - a)
        return table[-1][1]

    def resistance_n(self, head_m: float, speed_mps: float) -> float:
        """Davis, curve and tunnel."""
        a, b, c = self.trainset.davis.newtons(self.trainset.mass_kg)
        running = a + b * speed_mps + c * speed_mps**2
        return running + self.curve_n(head_m) + self.tunnel_n(head_m, speed_mps)

    # ---- what drives
    def available_n(self, speed_mps: float) -> tuple[float, float, float]:
        """Traction, electric brake, and brake that command -1 asks for, N."""
        t = self.trainset
        adhesion = t.adhesion * t.mass_kg * t.gravity_mps2
        electric = effort_n(t.electric_brake, speed_mps)
        service = t.service_deceleration_mps2 * t.effective_mass_kg
        brake = min(electric + t.friction_brake_n, service, adhesion)
        return min(effort_n(t.traction, speed_mps), adhesion), min(electric, adhesion), brake

    def delayed_command(self, dt: float) -> float:
        """The command issued ``delay_s`` before each instant of the newest step, averaged over that step."""
        newest = len(self.commands) - 1
        late = self.trainset.actuation.delay_s / dt
        whole = math.floor(late)
        part = late - whole

        def command_at(index: int) -> float:
            return self.commands[index] if index >= 0 else 0.0

        return (1.0 - part) * command_at(newest - whole) + part * command_at(newest - whole - 1)

    def step(self, command: float, dt: float) -> ReferenceState:
        """One control period with the forces found at its start."""
        s, t = self.state, self.trainset
        self.commands.append(min(max(command, -1.0), 1.0))
        target = self.delayed_command(dt)
        lag = t.actuation.lag_s
        share = target + (s.share - target) * (math.exp(-dt / lag) if lag > 0 else 0.0)
        traction, electric, brake = self.available_n(s.speed_mps)
        resistance = self.resistance_n(s.position_m, s.speed_mps)
        gradient = self.gradient_n(s.position_m)
        mass = t.effective_mass_kg
        wanted = share * (traction if share > 0 else brake)
        acceleration = (wanted - resistance - gradient) / mass
        room = t.actuation.jerk_limit_mps3 * dt
        acceleration = min(max(acceleration, s.acceleration_mps2 - room), s.acceleration_mps2 + room)
        force = min(max(acceleration * mass + resistance + gradient, -brake), traction)
        acceleration = (force - resistance - gradient) / mass
        if s.speed_mps == 0.0 and (acceleration <= 0.0 or share <= 0.0):
            self.state = self._standing(share, gradient, dt)
            return self.state
        duration, after = dt, s.speed_mps + acceleration * dt
        if after < 0.0:
            duration, after = s.speed_mps / -acceleration, 0.0
        return self._move(share, acceleration, force, electric, (resistance, gradient), duration, after)

    def _standing(self, share: float, gradient_n: float, dt: float) -> ReferenceState:
        s = self.state
        return ReferenceState(
            time_s=s.time_s + dt,
            position_m=s.position_m,
            share=share,
            friction_brake_n=-gradient_n,
            gradient_n=gradient_n,
            traction_j=s.traction_j,
            electric_brake_j=s.electric_brake_j,
            line_j=s.line_j + self.trainset.auxiliary_w * dt,
            recovered_j=s.recovered_j,
        )

    def _move(
        self,
        share: float,
        acceleration: float,
        force: float,
        electric_n: float,
        held_back: tuple[float, float],
        duration: float,
        after: float,
    ) -> ReferenceState:
        s, t = self.state, self.trainset
        moved = s.speed_mps * duration + 0.5 * acceleration * duration**2
        traction, braking = max(force, 0.0), max(-force, 0.0)
        electric = min(braking, electric_n)
        mean = 0.5 * (s.speed_mps + after)
        there_traction, there_electric, _ = self.available_n(mean)
        motoring = bilinear(t.efficiency_traction, mean, traction / max(there_traction, 1.0))
        recovering = bilinear(t.efficiency_braking, mean, electric / max(there_electric, 1.0))
        recovered = electric * moved * recovering * t.receptivity
        line = traction * moved / motoring + t.auxiliary_w * duration - recovered
        self.state = ReferenceState(
            s.time_s + duration,
            s.position_m + moved,
            after,
            acceleration,
            share,
            traction,
            electric,
            braking - electric,
            *held_back,
            s.traction_j + traction * moved,
            s.electric_brake_j + electric * moved,
            s.line_j + line,
            s.recovered_j + recovered,
        )
        return self.state
