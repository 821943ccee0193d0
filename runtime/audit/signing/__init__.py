"""What is signed of a log: checkpoints of its tree and its whole file, by keys of which each certifies the next."""
