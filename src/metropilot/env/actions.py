"""Kinds of action: the map from a policy's output (numbers or a choice) to a command in [-1, 1].

Each kind is written over the array namespace, so that a driver on the host maps actions exactly as the task
does. A kind is one small class and one row of :data:`ACTIONS`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from metropilot._registry import Registry, RegistryRow
from metropilot._schema import check_number
from metropilot._typing import Array, Bool, Num, Scalar
from metropilot.control import STARTS_SHARE, STOP_OPTIONS
from metropilot.env.features import FASTER_MPS, FeatureContext
from metropilot.env.interface import ActionSpace
from metropilot.errors import InputError
from metropilot.physics import command_for_force, scalars

EARLY_S = 0.2
"""Time before the scheduled arrival at which coasting is to arrive."""
LEAST_GAINED_S = 0.05
"""Least time that the higher speed of ``FASTER_MPS`` gains."""
RESERVE_SHARE = 0.03
"""Time to spare over the flat-out time to the stop below which the trainset is late, unless the limits ahead
cost more: what a drive loses at margins below limits and at releases of the brake."""
LATE_OVER_S = 0.5
"""Time to spare over which being late grows from none to whole."""
FAR_S = 45.0
"""Flat-out time to the stop from which on that says something: nearer all drives have little to spare."""
BEHIND_S = (0.1, 3.0)
"""Lateness of coasting from which on a trainset does something about it, and from which on that says nothing:
traction is still to come."""
SOON_SHARE = 1.5
"""Time left over the flat-out time to the stop below which there is little to spare."""
GAIN_S = 5.0
"""Time over which a trainset gains the speed that it lacks, or loses what it has too much."""
AHEAD_S, LEAST_LEFT_S = 2.0, 1.0
"""Time by which coasting arrives too early, from which on a trainset brakes; least time left that counts."""


STANDING_MPS, STARTS_MPS2 = 0.1, 0.3
"""A trainset slower than this before the stop is started, so fast."""


class AbstractAction(ABC):
    """Map from actions to commands.

    Attributes:
        kind: Id in :data:`ACTIONS`, as the file of a policy names it.
    """

    kind: ClassVar[str]

    @property
    @abstractmethod
    def space(self) -> ActionSpace:
        """Action space."""

    @abstractmethod
    def command(self, context: FeatureContext, action: Num[Array, "*actions"], period_s: float) -> Scalar:
        """The command in [-1, 1] that an action asks for.

        Args:
            context: What the policy saw when it acted.
            action: Shape (size,), or an integer choice of shape ().
            period_s: Time between two decisions.
        """

    @property
    def fading(self) -> bool:
        """True where tables count a brake that fades with what it gives at each speed, not its weakest."""
        return False

    def action_mask(self, context: FeatureContext, period_s: float) -> Bool[Array, " choices"] | None:
        """Mask of the choices allowed in a context. None: all."""
        del context, period_s
        return None

    def hold(self, context: FeatureContext, action: Num[Array, "*actions"], command: Scalar) -> Scalar:
        """Hold a decision to its end: by default the command as decided; a force is held, not its share."""
        del context, action
        return command

    def round(self, context: FeatureContext, command: Scalar) -> Scalar:
        """Round a command that assists have changed to one that can be given, a notch; by default itself."""
        del context
        return command


def _check_order(field: str, pair: tuple[float, float], allowed: str, *, equal: bool = False) -> None:
    """Raise an error unless the second number is larger than the first."""
    low, high = pair
    if not (low <= high if equal else low < high):
        raise InputError("out of range", field=field, value=pair[1], allowed=allowed)


@final
@dataclass(frozen=True)
class CommandAction(AbstractAction):
    """Command itself (Chen23a: share of the available traction or braking force)."""

    kind = "command"

    @property
    def space(self) -> ActionSpace:
        """Action space of one number."""
        return ActionSpace(size=1)

    def command(self, context: FeatureContext, action: Num[Array, "*actions"], period_s: float) -> Scalar:
        """Clip the number to [-1, 1]."""
        del period_s
        return context.xp.clip(action[0], -1.0, 1.0)


def needed_traction(context: FeatureContext, period_s: float) -> Scalar:
    """Command after which coasting to the station stop arrives in time; with more some would be braked away.

    Interpolated between the times of coasting from the speed and from a higher one, with the speed that the
    jerk limit still adds while traction is released, and the time that it takes to release the brake.

    Args:
        context: State.
        period_s: Time until the next decision, s.
    """
    xp, jerk = context.xp, context.vehicle.jerk_mps3
    taken = context.braked_coasting_s
    rising = xp.maximum(context.acceleration_mps2, 0.0)
    late_s = taken[0] + 0.5 * context.stop_mps2 / jerk + EARLY_S - context.left_s
    gained_spm = xp.maximum(taken[0] - taken[1], LEAST_GAINED_S) / FASTER_MPS[0]
    missing_mps = late_s / gained_spm - 0.5 * rising * rising / jerk
    return xp.clip(missing_mps / (period_s * context.effort_limits.traction_mps2), 0.0, 1.0)


def urgency(context: FeatureContext) -> Scalar:
    """Share of full traction that a trainset needs as the time left is hardly what flat out takes; else 0.

    Args:
        context: State.
    """
    xp = context.xp
    lost_s = context.rows.lost_s(context.case, context.position_m)
    reserve_s = xp.maximum(RESERVE_SHARE * context.to_go_s, lost_s)
    missing_s = reserve_s - (context.left_s - context.to_go_s)
    return xp.where(context.to_go_s > FAR_S, xp.clip(missing_s / LATE_OVER_S, 0.0, 1.0), 0.0 * missing_s)


def least_in_time(context: FeatureContext, needed: Scalar, period_s: float) -> Scalar:
    """Least command of a trainset that would arrive somewhat late if it coasted; -1 of any other.

    It does not brake for anything but a limit or the stop. With little time to spare it holds its speed where
    no fall does, and gains what is missing over ``GAIN_S``.

    Args:
        context: State.
        needed: Command after which coasting arrives in time, from :func:`needed_traction`.
        period_s: Time until the next decision, s.
    """
    xp = context.xp
    late_s = context.braked_coasting_s[0] - context.left_s
    held = xp.maximum(context.effort_limits.command_for(0.0), 0.0) + needed * min(period_s / GAIN_S, 1.0)
    least = xp.where(context.left_s < SOON_SHARE * context.to_go_s, xp.minimum(held, 1.0), 0.0)
    return xp.where((late_s > BEHIND_S[0]) & (late_s < BEHIND_S[1]), least, -1.0)


def start(context: FeatureContext, command: Scalar) -> Scalar:
    """Command that leaves no trainset standing before the stop.

    One that stands is held until there is traction, on a fall too; on a climb some traction is too little.

    Args:
        context: State.
        command: Command wanted.
    """
    xp = context.xp
    stands = (context.speed_mps <= STANDING_MPS) & (context.left_m > STOP_OPTIONS.inch_m)
    if xp is scalars and not stands:
        # one state on the host, nearly always in motion
        return command
    least = xp.maximum(context.effort_limits.command_for(STARTS_MPS2), STARTS_SHARE)
    return xp.where(stands, xp.maximum(command, least), command)


def most_in_time(context: FeatureContext) -> Scalar:
    """Largest command of a trainset that would arrive well before its time if it coasted; 1 of any other.

    So it is down a long fall, or after news of a later arrival. It holds the lower of two speeds: the share
    of the permitted one at which the flat-out way takes the time left, and the one speed that takes it with
    its braking.

    Args:
        context: State.
    """
    xp = context.xp
    left_s, brake_mps2 = xp.maximum(context.left_s, LEAST_LEFT_S), context.stop_mps2
    early_s = left_s - context.braked_coasting_s[0]
    root_s = xp.sqrt(xp.maximum(left_s * left_s - 2.0 * context.left_m / brake_mps2, 0.0))
    steady_mps = brake_mps2 * (left_s - root_s)
    held_mps = xp.minimum(context.to_go_s / left_s * context.permitted_mps, steady_mps)
    wanted = context.effort_limits.command_for((held_mps - context.speed_mps) / GAIN_S)
    return xp.where(early_s > AHEAD_S, xp.clip(wanted, -1.0, 1.0), 1.0)


@final
@dataclass(frozen=True)
class RegimeAction(AbstractAction):
    """Command with a dead zone for coasting and saturation at full effort.

    An optimal drive consists of full traction, speed holding, coasting and braking. A Gaussian policy never
    gives exactly 0 by itself, and needs a large mean for full effort.

    Attributes:
        coast: Absolute action up to which the trainset coasts.
        full: Absolute action from which effort is full.
        needed: No more traction than coasting from then on needs to arrive in time, full traction where even
            flat out is only just in time, and enough to depart.
    """

    kind = "regime"

    coast: float = 0.2
    full: float = 0.8
    needed: bool = False

    def __post_init__(self) -> None:
        """Check that the dead zone leaves a range for effort."""
        _check_order("coast", (0.0, self.coast), "0 or more, below full", equal=True)
        _check_order("full", (self.coast, self.full), "above coast")

    @property
    def space(self) -> ActionSpace:
        """Action space of one number."""
        return ActionSpace(size=1)

    @property
    def fading(self) -> bool:
        """With the rules, as the generalist drives; what other policies learned with stays as it was."""
        return self.needed

    def command(self, context: FeatureContext, action: Num[Array, "*actions"], period_s: float) -> Scalar:
        """Return 0 in the dead zone, then a linear rise to full effort."""
        xp = context.xp
        size = xp.clip((xp.abs(action[0]) - self.coast) / (self.full - self.coast), 0.0, 1.0)
        command = xp.where(action[0] < 0.0, -size, size)
        if not self.needed:
            return command
        urgent = urgency(context)
        most = needed_traction(context, period_s)
        least = xp.where(urgent > 0.0, xp.minimum(urgent, most), -1.0)
        least = xp.maximum(least, least_in_time(context, most, period_s))
        command = xp.maximum(xp.where(command > 0.0, xp.minimum(command, most), command), least)
        return start(context, xp.minimum(command, most_in_time(context)))


@final
@dataclass(frozen=True)
class IncrementAction(AbstractAction):
    """Change of the command (Huang25), which is thereby smooth.

    Attributes:
        rate_per_s: Largest rate of change of the command, 1/s.
    """

    kind = "increment"

    rate_per_s: float = 0.5

    def __post_init__(self) -> None:
        """Check that the rate is positive."""
        _check_order("rate_per_s", (0.0, self.rate_per_s), "above 0")

    @property
    def space(self) -> ActionSpace:
        """Action space of one number."""
        return ActionSpace(size=1)

    def command(self, context: FeatureContext, action: Num[Array, "*actions"], period_s: float) -> Scalar:
        """Add the change to the last command."""
        moved = context.command + self.rate_per_s * period_s * context.xp.clip(action[0], -1.0, 1.0)
        return context.xp.clip(moved, -1.0, 1.0)


@final
@dataclass(frozen=True)
class NotchAction(AbstractAction):
    """Choice from a table of notches: commands, or forces such as Lu23's twelve.

    Attributes:
        notches: Commands in [-1, 1], or forces in N, traction positive.
        forces: True if the notches are forces.
    """

    kind = "notches"

    notches: tuple[float, ...] = (-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0)
    forces: bool = False

    def __post_init__(self) -> None:
        """Check that there are notches, each a command or a finite force."""
        most = math.inf if self.forces else 1.0
        for notch in self.notches:
            check_number("notches", notch)
            if not (math.isfinite(notch) and abs(notch) <= most):
                allowed = "finite forces" if self.forces else "-1 to 1, or forces=True"
                raise InputError("out of range", field="notches", value=notch, allowed=allowed)
        if not self.notches:
            raise InputError("a policy needs a notch to choose", field="notches", allowed="1 or more")

    @property
    def space(self) -> ActionSpace:
        """Action space with one choice a notch."""
        return ActionSpace(count=len(self.notches))

    def command(self, context: FeatureContext, action: Num[Array, "*actions"], period_s: float) -> Scalar:
        """Command of the notch; a force is limited to the available one."""
        del period_s
        notch = context.rows.xp.asarray(self.notches, np.float32)[action]
        return command_for_force(context.vehicle, context.speed_mps, notch) if self.forces else notch


@final
@dataclass(frozen=True)
class GainsAction(AbstractAction):
    """Gains of a controller that holds a share of the permitted speed, on logarithmic scales.

    Attributes:
        low: Least value of each gain: proportional gain (1/(m/s)), and held over permitted speed.
        high: Largest value of each.
    """

    kind = "gains"

    low: tuple[float, ...] = (0.05, 0.3)
    high: tuple[float, ...] = (2.0, 1.0)

    def __post_init__(self) -> None:
        """Check that the ranges are positive and not empty; a gain may have a single value."""
        if not len(self.low) == len(self.high) == 2:
            raise InputError("not a range of two gains", field="high", value=len(self.high), allowed="2")
        for low, high in zip(self.low, self.high, strict=True):
            _check_order("low", (0.0, low), "above 0, at most high")
            _check_order("high", (low, high), "at least low", equal=True)

    @property
    def space(self) -> ActionSpace:
        """Action space of one number a gain."""
        return ActionSpace(size=len(self.low))

    def gains(self, context: FeatureContext, action: Num[Array, "*actions"]) -> Scalar:
        """Gains of an action. Shape (size,)."""
        xp = context.rows.xp
        low, high = (np.log(np.asarray(ends, np.float32)) for ends in (self.low, self.high))
        return xp.exp(low + (high - low) * (0.5 + 0.5 * xp.clip(action, -1.0, 1.0)))

    def command(self, context: FeatureContext, action: Num[Array, "*actions"], period_s: float) -> Scalar:
        """Command of proportional control toward the share of the permitted speed."""
        del period_s
        gain, share = self.gains(context, action)
        return context.xp.clip(gain * (share * context.permitted_mps - context.speed_mps), -1.0, 1.0)


ACTIONS: Registry[type[AbstractAction]] = Registry(
    "action",
    {
        kind.kind: RegistryRow(kind, (kind.__doc__ or "").partition("\n")[0])
        for kind in (CommandAction, RegimeAction, IncrementAction, NotchAction, GainsAction)
    }
    | {
        "expert": RegistryRow(
            "metropilot.studies.huang2025.env:ExpertAction", "Change of the rate inside the expert of Huang25"
        ),
        "notch_forces": RegistryRow(
            "metropilot.studies.lu2023.env:NotchForceAction", "Choice from a table of forces, filtered (Lu23)"
        ),
        "expert_choice": RegistryRow(
            "metropilot.studies.huang2025.env:ExpertChoiceAction", "Choice of a change of the rate inside it"
        ),
    },
)
"""Every kind of action; those of a paper are in its study."""
