"""A CAN bus as its wire behaves, without I/O and without a clock: bits, arbitration, errors, queues."""
