"""Registry of the drivers: one row each; listing them imports none of their files."""

from metropilot._registry import RegistryRow
from metropilot.sim import DRIVER_REGISTRY

DRIVERS = DRIVER_REGISTRY

DRIVERS.add(
    {
        "ddpg_pid": RegistryRow(
            "metropilot.studies.cheng2023.ddpg_pid:DdpgPid",
            "Incremental PID on a speed reference, gains from a policy learned by DDPG",
            "Cheng23",
        ),
        "dqn": RegistryRow(
            "metropilot.studies.lu2023.drivers:Dqn",
            "Learned by DQN over twelve notches for lu2023 WHY to WYJ, 118 to 142 s",
            "Lu23",
        ),
        "eitoe": RegistryRow(
            "metropilot.studies.huang2025.drivers:Eitoe",
            "Expert system: time window by minimal-time distribution, long coasting, online-learned stop",
            "Huang25",
        ),
        "eitop": RegistryRow(
            "metropilot.studies.huang2025.drivers:Eitop",
            "EITOE with the change of the rate learned by PPO",
            "Huang25",
        ),
        "flat_out": RegistryRow(
            "metropilot.drivers.flat_out:FlatOut", "As fast as limits, comfort and the trainset allow", "own"
        ),
        "fuzzy_pid": RegistryRow(
            "metropilot.studies.cheng2023.fuzzy_pid:FuzzyPid",
            "Incremental PID on a speed reference, gains changed by 7 x 7 fuzzy rules",
            "Cheng23 (F-PID); textbook rules",
        ),
        "generalist": RegistryRow(
            "metropilot.drivers.shipped:Generalist",
            "One policy for every line, learned on random sections and trainsets",
            "own",
        ),
        "improved_dqn": RegistryRow(
            "metropilot.studies.lu2023.drivers:ImprovedDqn",
            "Learned by improved DQN over twelve notches for lu2023 WHY to WYJ, 118 to 142 s",
            "Lu23",
        ),
        "itor": RegistryRow(
            "metropilot.studies.huang2025.drivers:Itor",
            "Expert rules, discrete changes learned by Q-learning in a table",
            "Yin et al. 2014, compared in Huang25",
        ),
        "learned": RegistryRow(
            "metropilot.drivers.shipped:FromFile",
            "A learned policy from a file or a learning run (--set policy=PATH or policy=RUN)",
            "own",
        ),
        "manual": RegistryRow(
            "metropilot.drivers.manual:Manual",
            "Model of a human driver: notches, reaction time, hysteresis, scatter",
            "own (Huang25's recorded drives are not public)",
        ),
        "mpc": RegistryRow(
            "metropilot.drivers.mpc:Mpc",
            "Model-predictive control: a new plan every 3 s, with the estimated plant",
            "own; convex plan in receding horizon",
        ),
        "neural_pid": RegistryRow(
            "metropilot.studies.cheng2023.neural_pid:NeuralPid",
            "Incremental PID on a speed reference, gains from a network that learns online",
            "Cheng23 (NN-PID); textbook network",
        ),
        "optimal": RegistryRow(
            "metropilot.drivers.optimal:Optimal",
            "Convex optimal plan in closed loop: follows, re-plans, stops at the point",
            "own; convex plan",
        ),
        "pid": RegistryRow(
            "metropilot.drivers.pid:Pid", "Incremental PID on a speed reference, fixed gains", "Cheng23"
        ),
        "pid_lu2023": RegistryRow(
            "metropilot.studies.lu2023.drivers:PidLu2023",
            "PID that tracks the speed curve of improved_dqn",
            "Lu23",
        ),
        "ppo": RegistryRow(
            "metropilot.drivers.shipped:Ppo",
            "Learned by PPO for RJ to WYJ, every load, running times up to 130 s",
            "own, after Chen23a",
        ),
        "ppo_scaled": RegistryRow(
            "metropilot.drivers.shipped:PpoScaled",
            "Learned by PPO with reward scaling for RJ to WYJ, every load, running times up to 130 s",
            "own, after Chen23a",
        ),
        "stod": RegistryRow(
            "metropilot.studies.huang2025.drivers:Stod",
            "Expert rules, continuous changes learned by DDPG",
            "Zhou et al. 2020",
        ),
        "ston": RegistryRow(
            "metropilot.studies.huang2025.drivers:Ston",
            "Expert rules, continuous changes learned by NAF",
            "Zhou et al. 2020, compared in Huang25",
        ),
    }
)
