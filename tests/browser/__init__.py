"""Pages that the program writes, opened in the Chromium of this machine."""
