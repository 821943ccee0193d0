"""The virtual bus: a hub process and a python-can plugin, for machines whose kernel has no CAN."""
