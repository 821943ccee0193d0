"""For whoever uses cutgate as a library: other arms, and the published distance. Nothing of the program imports this."""
