"""Titles, claims and captions of the published pages of studies: English there, translated when shown."""

from __future__ import annotations

from metropilot.web.words.language import N_

WORDS = (
    N_("the same"),
    N_("plain PPO, late, needs least energy"),
    N_("the same, least energy in its running time"),
    N_("SAC-PID keeps the gap"),
    N_("smallest"),
    N_("largest"),
    N_("DDPG-PID tracks the speed"),
    N_("DDPG-PID keeps the position"),
    N_("total error"),
    N_("largest error"),
    N_("robust against half the resistance"),
    N_("robust against a faster reference"),
    N_("robust against a slower reference"),
    N_("as a residual"),
    N_("total speed error"),
    N_("parking error"),
    N_("total position error"),
    N_("average speed error"),
    N_("improved DQN with the stop assist stops at the mark"),
    N_("it keeps the time"),
    N_("it saves energy"),
    N_("improved DQN converges faster than DQN"),
    N_("constant command"),
    N_("no number is printed"),
    N_("the paper prints a figure of its return, no number"),
    N_("Return"),
    N_("Mean impact rate"),
    N_("Speed error"),
    N_("Position error"),
    N_("every driver"),
)
"""Parts of claims and captions; those that are told whole are gathered from the pages."""
SENTENCES = (
    N_("around episode {number}"),
    N_("robust against {number} times the resistance"),
    N_("DDPG-PID has a smaller total speed error than {driver}"),
    N_("scenario {number}"),
    N_("jerk over {time} s"),
    N_("EITOE at {time} s"),
    N_("EITOP needs less energy than EITOE at {time} s"),
    N_("{driver} saves energy against manual driving at {time} s"),
    N_("the same at {time} s"),
    N_("EITOP is comfortable at {time} s"),
    N_("EITOE coasts a long way at {time} s"),
    N_("learning lowers the energy of case {number}"),
    N_("{speed} km/h at {place} m"),
    N_("{driver} with position and feed-forward, tuned"),
    N_("{driver} with position, tuned"),
    N_("{driver} at {speed} m/s², arrival of {other}"),
    N_("EITOP is on time, {origin} to {destination}"),
    N_("{driver} tuned"),
    N_(
        "{what} over episodes (its figs. {begin} to {end}). Blue: the policy's own run from standstill; "
        "orange: episodes with exploration. Lines: median over the seeds; areas: their range."
    ),
    N_(
        "{what} over episodes with the threshold of {time} s (its figs. {begin} to {end}). Blue: the "
        "policy's own run from standstill; orange: episodes with exploration. Lines: median over the "
        "seeds; areas: their range."
    ),
    N_(
        "{what} over episodes, with the certified optimum in {time} s (its figs. {begin} to {end}). "
        "Blue: the policy's own run from standstill; orange: episodes with exploration. Lines: median "
        "over the seeds; areas: their range."
    ),
    N_("Return over episodes, {time} s (its Fig. {number}): median and range"),
    N_("{what} over time in the base scenario, all drivers (Cheng23 fig. {number})."),
    N_("Ie of case {number} in J/kg while EITOP learns (its Fig. {place}): median and range"),
    N_("running time of case {number} in s while EITOP learns (its Fig. {place}): median and range"),
    N_("Case {number}, {drivers} (its Fig. {place})"),
    N_("{time} s, every driver (its Fig. {place})"),
    N_("EITOP with a new arrival time (its Fig. {place})"),
)
