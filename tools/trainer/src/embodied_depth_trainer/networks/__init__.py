"""The depth networks, what they take as input, and the weights that they begin with."""
