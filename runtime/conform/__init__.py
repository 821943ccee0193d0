"""The negative suite against a controller whose plant is disconnected: what it must refuse, it refuses."""
