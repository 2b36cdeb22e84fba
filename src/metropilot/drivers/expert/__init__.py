"""The expert system of Huang25 as drivers: what they share, in plain numbers for a fast decision."""
