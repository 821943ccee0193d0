"""Where the bone would have to be moved so that the path fits, or that it fits nowhere."""
