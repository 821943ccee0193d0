"""The negative suite of ``cutgate conform`` as tests of pytest, for whoever builds a controller (docs/hil.md)."""
