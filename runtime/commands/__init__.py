"""The commands, one module each: arguments and printing, nothing clever."""
