"""Training of the networks that the toolkit ships: their data, their losses, and the loop around them."""
