"""Huang et al. 2025: an expert system, and PPO inside it, against manual driving, ITOR and STON."""
