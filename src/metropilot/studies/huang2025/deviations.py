"""Where the study departs from the paper, and why."""

DEVIATIONS = (
    (
        "Manual driving is the project's surrogate, ten made-up drivers, not the best of 100 recorded "
        "drives, which are not public. Everything printed relative to it is therefore not comparable "
        "in size."
    ),
    (
        "Most equations and nearly all cells of Tables 1 to 4 are pictures that no text has. Ie is "
        "sum |a| v dt per kg, which turns the published 19.49 m/s of EITOE into its published 380 "
        "J/kg; Ic is the sum of all changes of effort over mass, without a threshold; parking "
        "tolerance 0.3 m."
    ),
    (
        "Gain 1, dead time 0.6 s and time constant 0.4 s stand for eq. 4, whose values are not "
        "printed; there is no other limit on the change of effort, as in the paper. Gradients and "
        "limits hold over the trainset's length of 118 m, and the sum of eq. 3 over the vehicles is "
        "driven; what its six vehicles would do under the same efforts is in a table at the end."
    ),
    (
        "The window of eq. 14 compares the mean speed of a trainset that coasts from here, not the "
        "speed itself, and always that to the destination. Compared plainly, or kept for each speed- "
        "limit interval as Algorithm 1 prints it, it cannot coast as long as the published drive; the "
        "table at the end has what the latter costs."
    ),
    (
        "Rule 4 is read as: no power beyond the speed that coasts to the next lower limit at that "
        "limit, while the minimum-time curve leaves time for it."
    ),
    (
        "A trainset that is early even if it coasts brakes gently (0.5 m/s²), as the paper's EITOP "
        "does in Fig. 11; so does EITOE here. Inside the window, which eqs. 15 and 16 leave open, "
        "EITOE powers until it would come on time, then coasts."
    ),
    (
        "One interval of rule 3 is our control period of 0.2 s; the paper decides every 0.02 s, for "
        "which there is a row. From the safe speed on (eqs. 17 and 18) the brake follows that speed's "
        "fall at 0.85 m/s² instead of full braking at once, and stays clear of protection's curves, "
        "which the paper's train meets."
    ),
    (
        "EITOP may accelerate at 0.8 m/s², everybody else inside the expert at the 0.6 of rule 2: the "
        "published 364 J/kg is what a peak of 19.08 m/s gives, and that needs 0.8. Each is compared "
        "with the optimum under its own limit, braking at most 1 m/s²."
    ),
    (
        "The station stop is HOA in the form its description has, with balises 64, 36, 16, 4 and 0 m "
        "before the stop; between them it also learns from the measured deceleration. Position is "
        "measured exactly, as everywhere here."
    ),
    (
        "EITOP learns on four sections of the line (case 1 among them) and any time from 1.08 to 1.45 "
        "of the minimum, not on case 1 alone, without dead time and lag. The weights of eq. 26 are "
        "ours: 1 a kWh, 3 a second off time at the end, 0.2 for 1 m/s² of change."
    ),
    (
        "ITOR, STON and STOD learn inside the same expert as EITOE, window included: a stronger "
        "baseline than the published ones, whose own expert rules have none. Tables and networks are "
        "ours, for none are printed."
    ),
)
