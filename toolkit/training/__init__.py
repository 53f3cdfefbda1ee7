"""Training of the networks the toolkit ships: what they see, what they are asked for, and the loop around it."""
