"""Registration: the cameras' poses corrected by what the images show, before anything is lifted or projected."""
