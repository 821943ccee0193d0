"""Both real loops under randomised faults: everything that can go wrong, at random and together, judged from outside."""
