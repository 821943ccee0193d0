"""Every parser against any bytes: the same promises that `make fuzz` searches for longer."""
