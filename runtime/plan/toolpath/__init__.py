"""Tool path files, one reader a language, to the poses between which each tool moves."""
