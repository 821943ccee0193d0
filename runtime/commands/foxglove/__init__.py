"""A log for the viewers of the Foxglove family: a second MCAP file, in the schemas that these draw."""
