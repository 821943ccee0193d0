"""What the page of the state machines is made of."""
