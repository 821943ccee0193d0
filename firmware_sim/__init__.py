"""The simulated controller, its plant and the virtual bus; an independent oracle of the runtime."""
