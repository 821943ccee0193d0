"""The simulated controller, its plant and the virtual bus; an independent witness of the runtime."""
