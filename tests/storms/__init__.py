"""Both real loops in bad weather: everything that can go wrong, at random and together, judged from outside."""
