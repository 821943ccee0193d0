"""Exhaustive exploration of interlock and controller together, on a modelled bus, in a modelled world."""
