"""Chen et al. 2023 (Actuators): train tracking in virtual coupling with SAC-PID, against DDPG-PID."""
