"""Titles, claims and captions of the published pages of studies: English there, translated when shown."""

from __future__ import annotations

from metropilot.web.words.language import N_

WORDS = (
    N_("plain PPO does not converge"),
    N_("PPO with reward scaling converges"),
    N_("the same"),
    N_("DDPG converges"),
    N_("DDPG needs most energy"),
    N_("plain PPO, late, needs least energy"),
    N_("DDPG has the highest impact rate"),
    N_("PPO with reward scaling drives best (return of the policy)"),
    N_("the same, least energy in its running time"),
    N_("SAC-PID keeps the gap"),
    N_("smallest"),
    N_("largest"),
    N_("SAC-PID keeps the speed"),
    N_("DDPG-PID fails to learn"),
    N_("DDPG-PID tracks the speed"),
    N_("DDPG-PID keeps the position"),
    N_("total error"),
    N_("largest error"),
    N_("DDPG-PID parks without an error"),
    N_("DDPG-PID is the most comfortable"),
    N_("energy of DDPG-PID"),
    N_("robust against half the resistance"),
    N_("robust against a faster reference"),
    N_("robust against a slower reference"),
    N_("as a residual"),
    N_("total speed error"),
    N_("parking error"),
    N_("total position error"),
    N_("average speed error"),
    N_("EITOP follows a later arrival"),
    N_("EITOP follows an earlier arrival"),
    N_("a decision of EITOP is quick"),
    N_("improved DQN stops at the mark"),
    N_("it keeps the time"),
    N_("it saves energy"),
    N_("improved DQN converges faster than DQN"),
    N_("constant command"),
    N_("no number is printed"),
    N_("the paper prints a figure of its return, no number"),
    N_("Chen et al. 2023: PPO with reward scaling"),
    N_("Chen et al. 2023: train tracking in virtual coupling"),
    N_("Tracking a reference: DDPG-PID against PID, fuzzy and neural PID (Cheng et al. 2023)"),
    N_("Expert driving, and PPO inside it (Huang et al. 2025)"),
    N_("Notch driving by improved DQN (Lu and Liu 2023)"),
    N_("A temporary restriction sent at 30 s"),
    N_("Limits and gradients (its Figs. 4 and 12)"),
    N_("Stops with a brake off by 30 %"),
    N_("Figs. 3 and 4: return of the episodes while learning, one line a seed."),
    N_("Figs. 3 and 4 over as many episodes as in the paper, one line a seed; eta 1000 is printed."),
    N_(
        "Gains that the learned policies set over the run, one line a seed; eta 1000 and the grey bounds are "
        "printed."
    ),
    N_("Figs. 5 and 6: policy loss of SAC, critic loss of DDPG, one line a seed."),
    N_("Fig. 7: speed of both trainsets under SAC-PID."),
    N_("Fig. 8: gap of every follower; the band is the published 5.88 to 5.98 m."),
    N_("Fig. 9: speed difference of every follower; published: below 0.15 m/s."),
    N_("Beyond the paper: the last trainset's swing of speed over the head's; above 1 it grows."),
    N_("Loss over episodes (its figs. 8 to 10), each learner's own: compare the course, not the size."),
    N_("Speed and notch over distance of the plans (its Fig. 8); grey is the limit"),
    N_("130 s: the learned drive, and the PID that tracks its curve (its Fig. 9)"),
    N_("DDPG-PID under half, plain and one and a half times the resistance (Cheng23 fig. 9)."),
    N_("DDPG-PID on the base, the faster and the slower reference (Cheng23 fig. 10)."),
    N_("Return"),
    N_("Mean impact rate"),
    N_("Speed error"),
    N_("Position error"),
    N_("every driver"),
)
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
