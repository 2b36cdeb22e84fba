"""Lu and Liu 2023: driving by twelve notches, learned by improved DQN."""
