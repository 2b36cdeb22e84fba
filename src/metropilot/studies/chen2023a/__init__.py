"""Chen et al. 2023: PPO with reward scaling, PPO and DDPG drive one section by position and speed."""
