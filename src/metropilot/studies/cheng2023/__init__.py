"""Cheng et al. 2023: tracking a reference with a PID whose gains are learned."""
